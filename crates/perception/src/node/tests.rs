//! The node over the embedded backend, with a device behind a pseudo-terminal.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32};
use std::sync::mpsc::{Receiver, channel};

use dermis_msgs::Message;
use dermis_msgs::lifecycle_msgs::srv::{
    ChangeState, ChangeStateRequest, GetAvailableTransitions, GetAvailableTransitionsRequest, GetState,
    GetStateRequest,
};
use dermis_msgs::rcl_interfaces::msg::Parameter;
use dermis_msgs::rcl_interfaces::srv::{
    DescribeParameters, DescribeParametersRequest, GetParameters, GetParametersRequest, SetParameters,
    SetParametersAtomically, SetParametersAtomicallyRequest, SetParametersRequest,
};
use dermis_msgs::srv::LoadModelRequest;
use dermis_msgs::std_srvs::srv::{SetBoolRequest, TriggerRequest};
use dermis_msgs::visualization_msgs::msg::Marker;
use dermis_node::network::SessionOptions;
use dermis_node::{HirozBackend, HirozConfig};
use dermis_transport::Pty;
use dermis_transport::framing::{NativeEncoder, NativeFormat};

use super::*;
use dermis_estimate::testing::{Noise, Out, PAD, TestBundle, skin_text};
use dermis_model::ForwardModel;
use dermis_skin::Family;

const WAIT: Duration = Duration::from_secs(60);

/// A pad behind a pseudo-terminal: 100 frames a second until it is dropped, which unplugs it.
struct Device {
    load: Arc<Mutex<[f32; 4]>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Device {
    fn plug(link: &Path) -> Self {
        let load = Arc::new(Mutex::new([0.0_f32; 4]));
        let stop = Arc::new(AtomicBool::new(false));
        let mut pty = Pty::open().unwrap();
        pty.link(link).unwrap();
        let thread = {
            let (load, stop) = (Arc::clone(&load), Arc::clone(&stop));
            std::thread::spawn(move || {
                let mut encoder = NativeEncoder::new(NativeFormat::F32);
                let mut noise = Noise::new(3);
                let begun = Instant::now();
                for k in 0_u32.. {
                    if stop.load(Ordering::Acquire) {
                        break;
                    }
                    let load = *load.lock().unwrap();
                    let values = load.map(|l| 101_325.0 + l + 20.0 * noise.normal() as f32);
                    let time = u64::try_from(begun.elapsed().as_micros()).unwrap() + 1;
                    let _ = pty.write_lossy(encoder.encode(k, time, &values).unwrap());
                    std::thread::sleep(Duration::from_millis(10));
                }
            })
        };
        Self { load, stop, thread: Some(thread) }
    }

    fn press(&self, load: [f32; 4]) {
        *self.load.lock().unwrap() = load;
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

struct Bench {
    folder: tempfile::TempDir,
    namespace: String,
    domain: u16,
}

impl Bench {
    fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let bench = Self {
            folder: tempfile::tempdir().unwrap(),
            namespace: format!("/b{}_{number}", std::process::id()),
            domain: u16::try_from(1 + std::process::id() % 100).unwrap(),
        };
        std::fs::write(bench.path("pad.toml"), skin_text("")).unwrap();
        TestBundle::default()
            .write(&SkinDescription::load(bench.path("pad.toml")).unwrap(), &bench.path("model"));
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn config(&self) -> Config {
        let mut config = Config::new(self.path("pad.toml"), format!("pty://{}", self.path("tty").display()));
        config.namespace.clone_from(&self.namespace);
        config.models = vec![self.path("model")];
        config.instance = Some("pad".into());
        config.domain_id = Some(self.domain);
        config.localhost_only = Some(true);
        config
    }

    fn backend() -> HirozBackend {
        // Networks of different tests do not see each other.
        let scouting_port = 20_000 + u16::try_from(std::process::id() % 10_000).unwrap();
        let session = SessionOptions {
            local_router: false,
            scouting_port: Some(scouting_port),
            ..SessionOptions::default()
        };
        HirozBackend::new(HirozConfig { session, ..HirozConfig::default() })
    }

    fn start(&self, config: &Config) -> SkinNode {
        SkinNode::start(PAD, config, &Self::backend()).unwrap()
    }

    fn refusal(&self, change: impl FnOnce(&mut Config)) -> String {
        let mut config = self.config();
        change(&mut config);
        let text = SkinNode::start(PAD, &config, &Self::backend()).err().unwrap().to_string();
        text.replace(&self.folder.path().display().to_string(), "DIR")
    }

    fn observer(&self) -> Node {
        let options = NodeOptions::new("observer").namespace(&self.namespace).domain_id(self.domain);
        Node::open(options.localhost_only(true), &Self::backend()).unwrap()
    }
}

fn listen<T: Message>(node: &Node, topic: &str, qos: Qos) -> (dermis_node::Subscription, Receiver<T>) {
    let (tx, rx) = channel();
    let subscription = node
        .subscribe::<T>(topic, qos, move |message, _| {
            // A test that got what it wanted hangs up.
            let _ = tx.send(message);
        })
        .unwrap();
    (subscription, rx)
}

/// The first message that fits.
fn expect<T: std::fmt::Debug>(rx: &Receiver<T>, what: &str, fits: impl Fn(&T) -> bool) -> T {
    let deadline = Instant::now() + WAIT;
    let mut last = None;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        match rx.recv_timeout(left) {
            Ok(message) if fits(&message) => return message,
            Ok(message) => last = Some(message),
            Err(_) => panic!("waited {WAIT:?} in vain: {what}; the last message was {last:?}"),
        }
    }
}

fn untouched(m: &ContactArray) -> bool {
    m.status == ContactArray::STATUS_OK && m.contacts.is_empty()
}

#[test]
fn frames_become_contacts() {
    let bench = Bench::new();
    let device = Device::plug(&bench.path("tty"));
    let running = bench.start(&bench.config());
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    expect(&contacts, "untouched", untouched);

    device.press([2000.0, 0.0, 0.0, 0.0]);
    let touched = expect(&contacts, "a contact", |m| !m.contacts.is_empty() && m.contacts[0].force.z < -1.5);
    let contact = &touched.contacts[0];
    assert_eq!((touched.status, touched.header.frame_id.as_str()), (ContactArray::STATUS_OK, "pad_link"));
    assert!((contact.position.x + 0.01).abs() < 1e-3 && contact.position.z == 0.0, "{:?}", contact.position);
    assert!((contact.force.z + 2.0).abs() < 0.3);
    let age = now_ns() - touched.header.stamp.as_nanos();
    assert!((0..WAIT.as_nanos() as i64).contains(&age), "stamped {age} ns ago");

    let (_taxels, taxels) = listen::<TaxelFrame>(&observer, "taxels", Qos::sensor_data());
    let frame = expect(&taxels, "a frame", |_| true);
    assert!((f64::from(frame.values[0]) - 103_325.0).abs() < 150.0, "readings before tare");
    let layout_id = frame.layout_id;
    assert!(frame.device_time_us > 0);
    let (_wrench, wrench) = listen::<WrenchStamped>(&observer, "wrench", Qos::sensor_data());
    assert!((expect(&wrench, "a wrench", |_| true).wrench.force.z + 2.0).abs() < 0.3);
    let (_points, points) = listen::<PointCloud2>(&observer, "contact_points", Qos::sensor_data());
    assert_eq!(expect(&points, "a cloud", |_| true).width, 1);
    let (_geometry, geometry) = listen::<SkinGeometry>(&observer, "skin_geometry", Qos::latched());
    let geometry = expect(&geometry, "the geometry, late", |_| true);
    assert_eq!((geometry.taxels.len(), geometry.points.len()), (4, 25));
    assert_eq!((geometry.unit.as_str(), geometry.channels.len(), geometry.layout_id), ("Pa", 4, layout_id));
    let (_markers, markers) = listen::<MarkerArray>(&observer, "contact_markers", Qos::reliable(1));
    expect(&markers, "an arrow", |m| m.markers[0].action == Marker::ADD);

    // Services.
    let tare = observer.client::<Trigger>("pad/tare").unwrap();
    let refused = tare.call_blocking(&TriggerRequest::default(), WAIT).unwrap();
    assert!(!refused.success && refused.message.contains("most in channel t0"), "{}", refused.message);
    device.press([0.0; 4]);
    expect(&contacts, "the release", untouched);
    expect(&markers, "no arrow", |m| m.markers[0].action == Marker::DELETEALL);
    let tared = tare.call_blocking(&TriggerRequest::default(), WAIT).unwrap();
    assert!(tared.success, "{}", tared.message);
    let load = observer.client::<LoadModel>("pad/load_model").unwrap();
    let missing = LoadModelRequest { bundle: bench.path("none").display().to_string() };
    let answer = load.call_blocking(&missing, WAIT).unwrap();
    assert!(!answer.success && answer.message.contains("there is none of that name"), "{}", answer.message);
    let mut harder = TestBundle::default();
    harder.outputs.last_mut().unwrap().clone_from(&Out::new("force.normal", "N", 2.0, [1.0; 4]));
    harder.write(running.skin(), &bench.path("harder"));
    let request = LoadModelRequest { bundle: bench.path("harder").display().to_string() };
    let answer = load.call_blocking(&request, WAIT).unwrap();
    assert!(answer.success && answer.message.contains("harder"), "{}", answer.message);
    device.press([2000.0, 0.0, 0.0, 0.0]);
    expect(&contacts, "twice the force", |m| {
        m.contacts.first().is_some_and(|c| (c.force.z + 4.0).abs() < 0.5)
    });

    // Parameters.
    let parameters = running.node().parameters();
    assert!(parameters.set("contact_threshold", -1.0).is_err());
    assert!(parameters.set("source", "udp://0.0.0.0:1").is_err());
    parameters.set("contact_threshold", 1e4).unwrap();
    expect(&contacts, "a threshold beyond the press", untouched);

    let status = running.diagnosis();
    assert_eq!(status.level, Level::Ok, "{}", status.message);
    let value = |key: &str| status.values.iter().find(|(k, _)| k == key).unwrap().1.clone();
    assert_eq!((value("CRC errors").as_str(), value("dead channels").as_str()), ("0", "none"));
    assert!(value("models").contains("linear"));

    let enable = observer.client::<SetBool>("pad/set_enabled").unwrap();
    assert!(enable.call_blocking(&SetBoolRequest { data: false }, WAIT).unwrap().success);
    let off = expect(&contacts, "switched off", |m| m.status == ContactArray::STATUS_STALE);
    assert!(off.contacts.is_empty() && off.status_text.contains("set_enabled"), "{}", off.status_text);
    running.stop();
}

#[test]
fn a_mounted_skin_says_where_it_is() {
    let bench = Bench::new();
    let _device = Device::plug(&bench.path("tty"));
    let observer = bench.observer();
    let publishers =
        || observer.endpoints("/tf_static", dermis_node::backend::EndpointKind::Publisher).unwrap();
    let unknown = bench.start(&bench.config());
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    expect(&contacts, "untouched", untouched);
    assert!(publishers().is_empty(), "a pose that nobody measured is not invented");
    unknown.stop();

    let mut config = bench.config();
    config.mount = Some(Mount::new("wrist", [0.1, 0.0, 0.02], [0.0, 0.0, 0.6, 0.8]).unwrap());
    config.frame_id = Some("left_pad".into());
    let _mounted = bench.start(&config);
    expect(&contacts, "the frame of this device", |m| m.header.frame_id == "left_pad");
    let (_transforms, transforms) = listen::<TFMessage>(&observer, "/tf_static", Qos::latched());
    let message = expect(&transforms, "the transform, late", |_| true);
    let [transform] = message.transforms.as_slice() else { panic!("{message:?}") };
    assert_eq!(
        (transform.header.frame_id.as_str(), transform.child_frame_id.as_str()),
        ("wrist", "left_pad")
    );
    let (at, turned) = (&transform.transform.translation, &transform.transform.rotation);
    assert_eq!([at.x, at.y, at.z], [0.1, 0.0, 0.02]);
    assert_eq!([turned.x, turned.y, turned.z, turned.w], [0.0, 0.0, 0.6, 0.8]);
}

#[test]
fn commands_that_are_switched_off_are_refused_and_reading_goes_on() {
    let bench = Bench::new();
    let _device = Device::plug(&bench.path("tty"));
    let running = bench.start(&Config { commands: "tare".parse().unwrap(), ..bench.config() });
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    expect(&contacts, "untouched", untouched);
    let tare = observer.client::<Trigger>("pad/tare").unwrap();
    let tared = tare.call_blocking(&TriggerRequest::default(), WAIT).unwrap();
    assert!(tared.success, "{}", tared.message);

    let enable = observer.client::<SetBool>("pad/set_enabled").unwrap();
    let answer = enable.call_blocking(&SetBoolRequest { data: false }, WAIT).unwrap();
    let why = "this node does not obey commands of the group `enable`: its configuration says `commands = [\"tare\"]`";
    assert_eq!((answer.success, answer.message.as_str()), (false, why));
    let load = observer.client::<LoadModel>("pad/load_model").unwrap();
    let answer = load.call_blocking(&LoadModelRequest { bundle: "model".into() }, WAIT).unwrap();
    assert!(!answer.success && answer.message.contains("the group `load`"), "{}", answer.message);

    // Parameters are read, not set; other nodes see that they cannot be.
    let set = observer.client::<SetParameters>("pad/set_parameters").unwrap();
    let value = ParameterValue::Double(9.0).to_msg();
    let change = Parameter { name: "contact_threshold".into(), value };
    let refused =
        set.call_blocking(&SetParametersRequest { parameters: vec![change.clone()] }, WAIT).unwrap().results;
    assert!(!refused[0].successful && refused[0].reason.contains("the group `parameters`"), "{refused:?}");
    let all = observer.client::<SetParametersAtomically>("pad/set_parameters_atomically").unwrap();
    let refused =
        all.call_blocking(&SetParametersAtomicallyRequest { parameters: vec![change] }, WAIT).unwrap();
    assert!(!refused.result.successful);
    let names = vec!["contact_threshold".to_owned()];
    let get = observer.client::<GetParameters>("pad/get_parameters").unwrap();
    let values = get.call_blocking(&GetParametersRequest { names: names.clone() }, WAIT).unwrap().values;
    assert_ne!(values[0].double_value, 9.0);
    let describe = observer.client::<DescribeParameters>("pad/describe_parameters").unwrap();
    let described = describe.call_blocking(&DescribeParametersRequest { names }, WAIT).unwrap();
    assert!(described.descriptors[0].read_only);

    // So is the state.
    let change = observer.client::<ChangeState>("pad/change_state").unwrap();
    let transition = dermis_msgs::lifecycle_msgs::msg::Transition { id: 0, label: "deactivate".into() };
    assert!(!change.call_blocking(&ChangeStateRequest { transition }, WAIT).unwrap().success);
    let state = observer.client::<GetState>("pad/get_state").unwrap();
    let now = state.call_blocking(&GetStateRequest::default(), WAIT).unwrap().current_state;
    assert_eq!(now.label, "active");
    let possible = observer.client::<GetAvailableTransitions>("pad/get_available_transitions").unwrap();
    let none = possible.call_blocking(&GetAvailableTransitionsRequest::default(), WAIT).unwrap();
    assert!(none.available_transitions.is_empty());
    expect(&contacts, "as before", untouched);
    running.stop();
}

/// A family whose forward model takes until [`COMPUTED`] says so.
const SLOW: &dyn Sensor = &Slow;

struct Slow;

impl Family for Slow {
    fn name(&self) -> &'static str {
        "pad"
    }
}

impl Sensor for Slow {
    fn about(&self) -> &'static str {
        "Reads a pad whose model takes its time"
    }

    fn nominal(&self, skin: &SkinDescription) -> Result<Arc<dyn ForwardModel>, ModelError> {
        while !COMPUTED.load(Ordering::Acquire) {
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(Arc::new(dermis_estimate::testing::Membrane::new(skin)))
    }
}

static COMPUTED: AtomicBool = AtomicBool::new(false);

#[test]
fn readings_come_while_the_model_is_computed() {
    let bench = Bench::new();
    let settings = dermis_inversion::Settings::new(0.004, 5.0);
    let skin = SkinDescription::load(bench.path("pad.toml")).unwrap();
    TestBundle { inversion: Some(settings), ..TestBundle::default() }.write(&skin, &bench.path("model"));
    let _device = Device::plug(&bench.path("tty"));
    let running = SkinNode::start(SLOW, &bench.config(), &Bench::backend()).unwrap();
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    let (_taxels, taxels) = listen::<TaxelFrame>(&observer, "taxels", Qos::sensor_data());
    expect(&taxels, "readings", |_| true);
    let waits = expect(&contacts, "the reason", |m| m.status == ContactArray::STATUS_UNCALIBRATED);
    assert!(waits.status_text.starts_with("the model (linear) is being made ready"), "{}", waits.status_text);
    let load = observer.client::<LoadModel>("pad/load_model").unwrap();
    let answer = load.call_blocking(&LoadModelRequest { bundle: "model".into() }, WAIT).unwrap();
    assert!(!answer.success && answer.message.contains("still being made ready"), "{}", answer.message);
    let status = running.diagnosis();
    assert!(status.values.iter().any(|(k, v)| k == "models" && v == "being made ready"), "{status:?}");
    COMPUTED.store(true, Ordering::Release);
    expect(&contacts, "contacts", untouched);
    let answer = load.call_blocking(&LoadModelRequest { bundle: "model".into() }, WAIT).unwrap();
    assert!(answer.success, "{}", answer.message);
    running.stop();
}

#[test]
fn a_device_on_the_other_wire_is_told_the_key() {
    let bench = Bench::new();
    let mut pty = Pty::open().unwrap();
    pty.link(bench.path("tty")).unwrap();
    let running = bench.start(&bench.config());
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    let deadline = Instant::now() + WAIT;
    loop {
        assert!(Instant::now() < deadline, "{:?}", running.diagnosis());
        let _ = pty.write_lossy(b"101325.0,101320.5,101318.0,101330.0\r\n");
        match contacts.recv_timeout(Duration::from_millis(10)) {
            Ok(message) if message.status == ContactArray::STATUS_FAULT => {
                let key = "write `[wire]` and below it `protocol = \"ascii\"` into the skin file";
                assert!(message.status_text.contains(key), "{}", message.status_text);
                break;
            }
            _ => {}
        }
    }
    assert_eq!(running.diagnosis().level, Level::Error);
}

#[test]
fn an_unplugged_skin_is_stale_and_comes_back() {
    let bench = Bench::new();
    let device = Device::plug(&bench.path("tty"));
    let running = bench.start(&bench.config());
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    expect(&contacts, "untouched", untouched);
    drop(device);
    let stale = expect(&contacts, "stale", |m| m.status == ContactArray::STATUS_STALE);
    assert!(stale.contacts.is_empty());
    assert!(stale.status_text.starts_with("no frame for "), "{}", stale.status_text);
    assert_eq!(running.diagnosis().level, Level::Stale);
    expect(&contacts, "it keeps saying so", |m| m.status == ContactArray::STATUS_STALE);
    let device = Device::plug(&bench.path("tty"));
    expect(&contacts, "back", untouched);
    device.press([0.0, 3000.0, 0.0, 0.0]);
    expect(&contacts, "a contact", |m| m.contacts.first().is_some_and(|c| c.position.x > 0.0));
}

#[test]
fn a_second_sender_on_the_port_is_left_out_and_diagnosed() {
    let bench = Bench::new();
    let bind = || std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let to = bind().local_addr().unwrap();
    let mut config = bench.config();
    config.source = format!("udp://{to}?hold=5");
    let running = bench.start(&config);
    let stop = Arc::new(AtomicBool::new(false));
    let sender = || {
        let (socket, stop) = (bind(), Arc::clone(&stop));
        let own = socket.local_addr().unwrap();
        let thread = std::thread::spawn(move || {
            let mut encoder = NativeEncoder::new(NativeFormat::F32);
            for k in 0_u32.. {
                if stop.load(Ordering::Acquire) {
                    break;
                }
                let _ = socket.send_to(encoder.encode(k, 1, &[101_325.0 + (k % 40) as f32; 4]).unwrap(), to);
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        (own, thread)
    };
    let until = |what: &str, holds: &dyn Fn(&Status) -> bool| {
        let deadline = Instant::now() + WAIT;
        loop {
            let status = running.diagnosis();
            if holds(&status) {
                return status;
            }
            assert!(Instant::now() < deadline, "never came: {what}; {status:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    let value = |status: &Status, key: &str| {
        status.values.iter().find(|(k, _)| k == key).map_or(String::new(), |(_, value)| value.clone())
    };
    let (first, one) = sender();
    until("frames", &|s| value(s, "frames").parse::<u64>().is_ok_and(|n| n > 5));
    let (second, two) = sender();
    let sentence = format!("{second} wants to send too and is left out, while {first} is read");
    let status = until("the warning", &|s| s.message.contains(&sentence));
    assert!(status.level >= Level::Warn);
    assert_eq!(value(&status, "other senders"), second.to_string());
    assert_ne!(value(&status, "datagrams of others"), "0");
    stop.store(true, Ordering::Release);
    one.join().unwrap();
    two.join().unwrap();
    running.stop();
}

#[test]
fn a_foreign_device_is_a_fault_with_one_sentence() {
    let bench = Bench::new();
    let running = bench.start(&bench.config());
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    let nothing = expect(&contacts, "no device yet", |m| m.status == ContactArray::STATUS_STALE);
    assert!(nothing.status_text.contains("tty"), "{}", nothing.status_text);

    let mut pty = Pty::open().unwrap();
    pty.link(bench.path("tty")).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let chatter = std::thread::spawn(move || {
        while !stopped.load(Ordering::Acquire) {
            let _ = pty.write_lossy(b"$GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M\r\n");
            let _ = pty.flush();
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    let fault = expect(&contacts, "a fault", |m| m.status == ContactArray::STATUS_FAULT);
    stop.store(true, Ordering::Release);
    chatter.join().unwrap();
    assert!(fault.contacts.is_empty());
    assert!(
        fault.status_text.starts_with("skin `pad` on pty://")
            && fault.status_text.contains("the device sends text"),
        "{}",
        fault.status_text
    );
    running.stop();
}

#[test]
fn a_model_that_does_not_fit_leaves_the_readings() {
    let bench = Bench::new();
    let device = Device::plug(&bench.path("tty"));
    let graph = bench.path("model/model.onnx");
    let bytes = std::fs::read(&graph).unwrap();
    std::fs::write(&graph, &bytes[..bytes.len() / 2]).unwrap();
    let running = bench.start(&bench.config());
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    let (_taxels, taxels) = listen::<TaxelFrame>(&observer, "taxels", Qos::sensor_data());
    device.press([2000.0, 0.0, 0.0, 0.0]);
    expect(&taxels, "readings", |f| f.values[0] > 102_000.0);
    let message = expect(&contacts, "the reason", |m| m.status == ContactArray::STATUS_UNCALIBRATED);
    assert!(message.contacts.is_empty());
    assert!(message.status_text.contains("model.onnx: has "), "{}", message.status_text);
    running.stop();
    let strict = bench.refusal(|c| c.strict = true);
    assert!(strict.starts_with("model file DIR/model/model.onnx: has "), "{strict}");
}

#[test]
fn a_lifecycle_manager_decides_where_asked() {
    let bench = Bench::new();
    let _device = Device::plug(&bench.path("tty"));
    let running = bench.start(&Config { autostart: false, ..bench.config() });
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    let life = running.node().lifecycle().unwrap();
    assert_eq!(life.state(), State::Unconfigured);
    life.take(Transition::Configure).unwrap();
    let refused = running.shared.tare().unwrap_err();
    assert!(refused.contains("not active"), "{refused}");
    life.take(Transition::Activate).unwrap();
    expect(&contacts, "untouched", untouched);
    life.take(Transition::Deactivate).unwrap();
    assert_eq!(life.state(), State::Inactive);
}

#[test]
fn what_cannot_be_is_refused_in_one_sentence() {
    let bench = Bench::new();
    std::fs::write(bench.path("other.toml"), skin_text("sensor = \"camera\"")).unwrap();
    std::fs::write(bench.path("typo.toml"), skin_text("nosie = 3")).unwrap();
    insta::assert_snapshot!(bench.refusal(|c| c.skin = bench.path("none.toml")), @"skin file DIR/none.toml: cannot be read: No such file or directory (os error 2); check the path and its permissions");
    insta::assert_snapshot!(bench.refusal(|c| c.skin = bench.path("other.toml")), @r#"skin file DIR/other.toml: field `sensor`: is "camera", which this node does not read; it reads "pad""#);
    assert!(bench.refusal(|c| c.skin = bench.path("typo.toml")).contains("unknown key `nosie`"));
    assert!(bench.refusal(|c| c.source = "seriol:///dev/ttyACM0".into()).contains("unknown scheme `seriol`"));
    insta::assert_snapshot!(bench.refusal(|c| c.masked = vec!["t7".into()]), @"masked channel `t7` is none of skin `pad`; its channels are t0, t1, t2, t3");
    insta::assert_snapshot!(bench.refusal(|c| {
        c.strict = true;
        c.models = vec![bench.path("none")];
    }), @"model bundle DIR/none: there is no such folder; train one with `dermis train` or correct the path");
    insta::assert_snapshot!(bench.refusal(|c| {
        c.parameters.insert("contact_treshold".into(), 3.into());
    }), @"parameter `contact_treshold` is none of this node; its parameters are contact_threshold, correction, drift_time, force_threshold, frame_id, masked, models, mount_parent, mount_pose, release_share, skin, skin_hash, skin_type, source, stale_time, stuck_time, tare_duration, tare_while_touched, use_sim_time");
    insta::assert_snapshot!(bench.refusal(|c| {
        c.parameters.insert("contact_threshold".into(), "high".into());
    }), @r#"parameter `contact_threshold`: its type is double, but the value given at start is the string "high""#);
    insta::assert_snapshot!(bench.refusal(|c| {
        c.parameters.insert("skin".into(), "left".into());
    }), @"parameter `skin` follows from the configuration: write `instance` there, and leave it out of `parameters`");
    insta::assert_snapshot!(bench.refusal(|c| c.instance = Some("left pad".into())), @r#"`instance`: "left pad" is no name of a skin: take up to 128 letters, digits, `_` and `-`"#);
    insta::assert_snapshot!(bench.refusal(|c| c.mount = Some("pad_link,0,0,0".parse().unwrap())), @r#"`mount.parent` is "pad_link", the skin's own `frame_id`: name the link that the skin is fixed to"#);
    assert!(
        bench
            .refusal(|c| (c.correction, c.strict) = (Some(bench.path("none.json")), true))
            .contains("none.json")
    );
}

#[test]
fn a_node_says_which_device_it_reads() {
    let bench = Bench::new();
    let mut config = bench.config();
    config.instance = None;
    config.name = Some("palm".into());
    config.frame_id = Some("left_link".into());
    config.mount = Some("wrist,0,0.5,0".parse().unwrap());
    config.masked = vec!["t1".into()];
    let running = bench.start(&config);
    let text = |name: &str| running.node().parameters().get(name).unwrap().to_string();
    let name = format!("{}_palm", bench.namespace.trim_start_matches('/'));
    assert_eq!(running.skin().name, name, "the node's full name");
    let hash = SkinDescription::load(bench.path("pad.toml")).unwrap().hash();
    for (parameter, expected) in [
        ("skin", name.as_str()),
        ("skin_type", "pad"),
        ("skin_hash", hash.as_str()),
        ("frame_id", "left_link"),
        ("mount_parent", "wrist"),
        ("mount_pose", "[0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0]"),
        ("masked", "[\"t1\"]"),
    ] {
        assert_eq!(text(parameter).trim_matches('"'), expected, "{parameter}");
    }
    let figures = running.diagnosis().values;
    let of_type = figures.iter().find(|(key, _)| key == "skin type").unwrap();
    assert!(of_type.1.starts_with("pad (sha256:"), "{of_type:?}");
}

//! A node that runs: contacts, commands, models, lifecycle.

use dermis_estimate::testing::Out;
use dermis_model::ForwardModel;
use dermis_msgs::geometry_msgs::msg::WrenchStamped;
use dermis_msgs::lifecycle_msgs::srv::{
    ChangeState, ChangeStateRequest, GetAvailableTransitions, GetAvailableTransitionsRequest, GetState,
    GetStateRequest,
};
use dermis_msgs::msg::{SkinGeometry, TaxelFrame};
use dermis_msgs::rcl_interfaces::msg::Parameter;
use dermis_msgs::rcl_interfaces::srv::{
    DescribeParameters, DescribeParametersRequest, GetParameters, GetParametersRequest, SetParameters,
    SetParametersAtomically, SetParametersAtomicallyRequest, SetParametersRequest,
};
use dermis_msgs::sensor_msgs::msg::PointCloud2;
use dermis_msgs::srv::{LoadModel, LoadModelRequest};
use dermis_msgs::std_srvs::srv::{SetBool, SetBoolRequest, Trigger, TriggerRequest};
use dermis_msgs::tf2_msgs::msg::TFMessage;
use dermis_msgs::visualization_msgs::msg::{Marker, MarkerArray};
use dermis_node::{ParameterValue, State, Transition};
use dermis_sensor::Sensor;
use dermis_skin::{Family, ModelError, Mount};
use dermis_transport::now_ns;

use super::*;

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
fn contacts_are_looked_for_ten_times_a_second_while_nobody_listens() {
    let bench = Bench::new();
    let device = Device::plug(&bench.path("tty"));
    let running = bench.start(&bench.config());
    let observer = bench.observer();
    let (_taxels, taxels) = listen::<TaxelFrame>(&observer, "taxels", Qos::sensor_data());
    let counts = || {
        let core = running.shared.lock();
        (core.figures.frames_total, core.figures.unheard_total)
    };
    let before = counts();
    // Readings are published of every frame.
    let first = expect(&taxels, "a frame", |_| true).sequence;
    let last = expect(&taxels, "frames of a second", |m| m.sequence >= first + 100).sequence;
    let after = counts();
    let (frames, unheard) = (after.0 - before.0, after.1 - before.1);
    let estimated = frames - unheard;
    assert!(frames >= last - first && unheard > frames / 2, "{unheard} of {frames}");
    let seconds = frames as f64 / running.skin().rate;
    assert!((estimated as f64) < 10.0 * seconds + 3.0, "{estimated} of {frames} were estimated");

    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    device.press([2000.0, 0.0, 0.0, 0.0]);
    expect(&contacts, "a contact", |m| !m.contacts.is_empty());
    let (frames, unheard) = counts();
    expect(&taxels, "further frames", |m| m.sequence >= last + 100);
    let (more, still) = counts();
    assert!(more > frames && still == unheard, "{still} of {more}, {unheard} of {frames} before");
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
        Ok(Arc::new(dermis_estimate::testing::membrane(skin)))
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
fn a_lifecycle_manager_decides_where_requested() {
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

//! Models that nobody should be able to harm a node with, across processes: each is refused with a sentence, and the node goes on
//! with the model that it had. And how fast a node is back that was killed.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::fs::File;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use dermis_inference::onnx::{Element, GraphBuilder, Value};
use dermis_inference::{
    Baseline, Bundle, BundleWriter, FeatureConfig, Manifest, OutputConfig, OutputSpec, Runtime,
    RuntimeConfig, TrainingSection,
};
use dermis_integration_tests::{Peer, domain, listen, open_node, program, refused, root};
use dermis_msgs::msg::ContactArray;
use dermis_msgs::srv::{LoadModel, LoadModelRequest};
use dermis_node::{Node, Qos, Subscription};
use dermis_skin::SkinDescription;
use dermis_transport::Pty;
use dermis_transport::framing::{NativeEncoder, NativeFormat};

const SOON: Duration = Duration::from_secs(60);
const CHANNELS: usize = 6;

fn skin_file() -> PathBuf {
    root().join("launch/skins/baro-line.toml")
}

/// A row of barometers that nothing touches, on a pseudo-terminal.
struct Device {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Device {
    fn plug(link: &Path) -> Self {
        let mut pty = Pty::open().unwrap();
        pty.link(link).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut encoder = NativeEncoder::new(NativeFormat::F32);
            for k in 0_u32.. {
                if ends.load(Ordering::Acquire) {
                    return;
                }
                let values: [f32; CHANNELS] =
                    std::array::from_fn(|i| 15.0 * [1.0, -1.0, -1.0, 1.0][(k as usize + i) % 4]);
                let _ = pty.write_lossy(encoder.encode(k, 1 + u64::from(k) * 10_000, &values).unwrap());
                std::thread::sleep(Duration::from_millis(10));
            }
        });
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// A bundle for the row, whose graph is what `make` makes of its input: one position and one force.
fn bundle(folder: &Path, make: impl FnOnce(&mut GraphBuilder, &Value) -> Value) {
    let skin = SkinDescription::load(skin_file()).unwrap();
    let input = FeatureConfig::newest(vec![0.0; CHANNELS], vec![1000.0; CHANNELS]);
    let output = OutputConfig {
        values: ["position.x", "position.y", "force.normal"]
            .map(|name| OutputSpec::new(name, if name.starts_with('p') { "m" } else { "N" }, 0.0, 0.01))
            .to_vec(),
    };
    let manifest = Manifest::new("line", &skin, Baseline::Tared, input, output, TrainingSection::default());
    let mut graph = GraphBuilder::new("line");
    let x = graph.input("input", &[1, CHANNELS]);
    let y = make(&mut graph, &x);
    graph.output("output", &y, &[1, 3]);
    BundleWriter::new(manifest).write(folder, &graph.finish().unwrap()).unwrap();
}

fn linear(g: &mut GraphBuilder, x: &Value, weight: f32) -> Value {
    let w = g.constant("weight", &[CHANNELS, 3], &[weight; CHANNELS * 3]);
    g.matmul(x, &w)
}

/// A square of ones, that is made when the graph is loaded or run.
fn square(g: &mut GraphBuilder, side: i64) -> Value {
    let shape = g.constant_i64("shape", &[2], &[side, side]);
    let zeros = g.operator("ConstantOfShape", &[&shape], &[], 1).remove(0);
    let one = g.constant("one", &[1], &[1.0]);
    g.add(&zeros, &one)
}

/// Adds nothing but the work of `value` to what a linear model says.
fn beside(g: &mut GraphBuilder, x: &Value, value: &Value) -> Value {
    let y = linear(g, x, 1.0);
    let rows = g.reduce_mean(value, 0);
    let mean = g.reduce_mean(&rows, 1);
    let mean = g.cast(&mean, Element::F32);
    g.add(&y, &mean)
}

struct Bench {
    folder: tempfile::TempDir,
    node: Node,
    contacts: Receiver<ContactArray>,
    _subscription: Subscription,
}

impl Bench {
    fn new() -> Self {
        let node = open_node("operator");
        let (subscription, contacts) = listen(&node, "contacts", Qos::sensor_data());
        let folder = tempfile::tempdir().unwrap();
        bundle(&folder.path().join("models/good"), |g, x| linear(g, x, 1.0));
        Self { folder, node, contacts, _subscription: subscription }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn start(&self, arguments: &[&str]) -> Peer {
        let mut command = Command::new(program("dermis"));
        command.arg("barodome").arg("--skin").arg(skin_file()).args(arguments);
        command.arg("--source").arg(format!("serial://{}", self.path("tty").display()));
        command.env("XDG_CACHE_HOME", self.path("cache"));
        Peer::start(command.stderr(File::create(self.path("log")).unwrap()))
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.path("log")).unwrap_or_default()
    }

    /// Waits until contacts are known, by what comes from here on.
    fn sees(&self) {
        while self.contacts.try_recv().is_ok() {}
        let deadline = Instant::now() + SOON;
        loop {
            match self.contacts.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(array) if array.status == ContactArray::STATUS_OK => return,
                Ok(_) => {}
                Err(_) => panic!("no contacts are known:\n{}", self.log()),
            }
        }
    }

    fn load(&self, name: &str) -> Result<String, String> {
        let client = self.node.client::<LoadModel>("/baro_line/load_model").unwrap();
        let answer = client.call_blocking(&LoadModelRequest { bundle: name.into() }, SOON).unwrap();
        if answer.success { Ok(answer.message) } else { Err(answer.message) }
    }
}

#[test]
fn no_model_harms_a_node() {
    let bench = Bench::new();
    let models = bench.path("models");
    let at = |name: &str| models.join(name);
    let good = |name: &str| bundle(&at(name), |g, x| linear(g, x, 1.0));
    // Outside of the folder of the configured model, and a link there.
    bundle(&bench.path("elsewhere/secret"), |g, x| linear(g, x, 1.0));
    symlink(bench.path("elsewhere/secret"), at("link")).unwrap();
    bundle(&at("nan"), |g, x| linear(g, x, f32::NAN));
    bundle(&at("inverse"), |g, x| {
        let y = linear(g, x, 1.0);
        let one = g.constant("one", &[1, 3], &[1.0; 3]);
        g.div(&one, &y)
    });
    good("sparse");
    File::options().write(true).open(at("sparse/model.onnx")).unwrap().set_len(8 << 30).unwrap();
    good("pipe");
    std::fs::remove_file(at("pipe/model.onnx")).unwrap();
    assert!(Command::new("mkfifo").arg(at("pipe/model.onnx")).status().unwrap().success());
    good("zeros");
    std::fs::remove_file(at("zeros/model.onnx")).unwrap();
    symlink("/dev/zero", at("zeros/model.onnx")).unwrap();
    bundle(&at("large"), |g, x| {
        let ones = square(g, 1 << 15);
        beside(g, x, &ones)
    });
    // Some 10¹⁴ multiplications in a few megabytes.
    bundle(&at("slow"), |g, x| {
        let mut product = square(g, 1 << 10);
        for _ in 0..50_000 {
            product = g.matmul(&product, &product.clone());
        }
        beside(g, x, &product)
    });
    good("better");

    let _device = Device::plug(&bench.path("tty"));
    let config = bench.path("node.toml");
    std::fs::write(
        &config,
        format!(
            "skin = {:?}\nsource = 'serial://{}'\nmodels = ['models/good']\n[model_limits]\nseconds = 2\n",
            skin_file(),
            bench.path("tty").display()
        ),
    )
    .unwrap();
    let mut command = Command::new(program("dermis"));
    command.arg("barodome").arg("--config").arg(&config).env("XDG_CACHE_HOME", bench.path("cache"));
    let node = Peer::start(command.stderr(File::create(bench.path("log")).unwrap()));
    bench.sees();
    let before = node.memory();

    let secret = bench.path("elsewhere/secret").display().to_string();
    for (name, reason) in [
        ("nan", "constant `weight` holds NaN"),
        ("inverse", "answers inf to plausible readings"),
        ("../elsewhere/secret", "without `..`"),
        ("../../../../../../etc", "without `..`"),
        (secret.as_str(), "does not lie in"),
        ("link", "does not lie in"),
        ("sparse", "has 8589934592 bytes"),
        ("pipe", "is no plain file"),
        ("zeros", "is a link that leads out of"),
        ("large", "failed its trial"),
        ("slow", "failed its trial"),
        ("nothing", "there is none of that name"),
    ] {
        let begun = Instant::now();
        let text = bench.load(name).unwrap_err();
        assert!(text.contains(reason), "{name}: {text}");
        assert!(begun.elapsed() < Duration::from_secs(30), "{name} took {:?}", begun.elapsed());
        // It goes on with the model that it had.
        bench.sees();
    }
    let grown = node.memory().saturating_sub(before);
    assert!(grown < 100 << 20, "the node has grown by {grown} bytes");
    let text = bench.load("better").unwrap();
    assert!(text.contains("models/better"), "{text}");
    bench.sees();
}

/// The trial of a bundle is the node's at its start, too.
#[test]
fn a_configured_model_is_tried_before_it_is_used() {
    let bench = Bench::new();
    bundle(&bench.path("models/large"), |g, x| {
        let ones = square(g, 1 << 15);
        beside(g, x, &ones)
    });
    let mut command = Command::new(program("dermis"));
    command.args(["barodome", "--strict", "--source", "pty:///nowhere", "--skin"]).arg(skin_file());
    command.arg("--model").arg(bench.path("models/large")).args(["--cache", "off"]);
    command.env("ROS_DOMAIN_ID", domain().to_string()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    let text = refused(&mut command);
    assert!(text.contains("model.onnx: failed its trial: "), "{text}");
    // The file itself is a whole bundle: nothing was found wrong with it without a run.
    Bundle::load(bench.path("models/large"), &SkinDescription::load(skin_file()).unwrap()).unwrap();
}

/// Readings and status come while the forward model is computed, and what it took seconds for is there at once the second time,
/// unless somebody has damaged it.
#[test]
fn a_node_reads_while_it_computes_and_computes_once() {
    let bench = Bench::new();
    let _device = Device::plug(&bench.path("tty"));
    let model = root().join("models/baro-line").display().to_string();
    let run = || {
        let mut node = bench.start(&["--model", &model]);
        bench.sees();
        node.kill();
        bench.log()
    };
    let cold = run();
    assert!(cold.contains("makes the model ready (baro-line)"), "{cold}");
    assert!(cold.contains("computes the pressure in the elastomer under a tip"), "{cold}");
    assert!(cold.contains("is ready after "), "{cold}");
    let warm = run();
    assert!(warm.contains("found the pressure in the elastomer under a tip in the cache"), "{warm}");
    assert!(!warm.contains("computes "), "{warm}");
    let entries = || std::fs::read_dir(bench.path("cache/dermis")).unwrap().map(|e| e.unwrap().path());
    assert!(entries().count() >= 2, "the tables, and the trial of the model");
    for entry in entries() {
        let mut bytes = std::fs::read(&entry).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        std::fs::write(&entry, bytes).unwrap();
    }
    let mended = run();
    assert!(mended.contains("is ignored: it is damaged"), "{mended}");
    assert!(mended.contains("computes the pressure in the elastomer under a tip"), "{mended}");
    assert!(!run().contains("computes "));
}

/// What ships passes the checks that what comes from outside has to pass.
#[test]
fn the_models_that_ship_are_taken() {
    dermis_skin::register(dermis_insight::FAMILY);
    let runtime = Runtime::load(&RuntimeConfig::default()).unwrap();
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("models")).unwrap() {
        let path = entry.unwrap().path();
        if !path.is_dir() {
            continue;
        }
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let skin = name.trim_end_matches("-two").trim_end_matches("-x");
        let skin = SkinDescription::load(root().join(format!("launch/skins/{skin}.toml"))).unwrap();
        let bundle = Bundle::load(&path, &skin).unwrap();
        bundle.session(runtime).unwrap_or_else(|e| panic!("{name}: {e}"));
        bundle.sensitivity(runtime).unwrap_or_else(|e| panic!("{name}: {e}"));
        count += 1;
    }
    assert!(count >= 7, "{count} bundles");
}

//! The node over the embedded backend, with a device behind a pseudo-terminal.

mod configuration;
mod link;
mod running;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use dermis_estimate::testing::{Noise, PAD, TestBundle, skin_text};
use dermis_msgs::Message;
use dermis_msgs::msg::ContactArray;
use dermis_node::network::SessionOptions;
use dermis_node::{HirozBackend, HirozConfig, Level, Node, NodeOptions, Qos};
use dermis_skin::SkinDescription;
use dermis_transport::Pty;
use dermis_transport::framing::{NativeEncoder, NativeFormat};

use super::SkinNode;
use crate::config::Config;

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

//! What an operator of a limb starts and hears.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use std::time::Instant;

use dermis_integration_tests::{Peer, backend, domain, program, root};
use dermis_inversion::Settings;
use dermis_msgs::Message;
use dermis_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use dermis_msgs::msg::ContactArray;
use dermis_node::{Node, NodeOptions, Qos, Subscription};

use super::{SOON, TIP, bundle};

/// What an operator hears.
pub(super) struct Operator {
    pub(super) folder: tempfile::TempDir,
    pub(super) node: Node,
    pub(super) subscriptions: Vec<Subscription>,
    pub(super) contacts: Receiver<ContactArray>,
    pub(super) diagnostics: Receiver<DiagnosticStatus>,
}

impl Operator {
    pub(super) fn new() -> Self {
        let node =
            Node::open(NodeOptions::new("operator").domain_id(domain()).localhost_only(true), &backend())
                .unwrap();
        let mut operator = Self {
            folder: tempfile::tempdir().unwrap(),
            node,
            subscriptions: Vec::new(),
            contacts: channel().1,
            diagnostics: channel().1,
        };
        operator.contacts = operator.listen("contacts", Qos::sensor_data());
        let (say, diagnostics) = channel();
        let heard = operator
            .node
            .subscribe::<DiagnosticArray>("/diagnostics", Qos::reliable(10), move |array, _| {
                array.status.into_iter().for_each(|status| {
                    let _ = say.send(status);
                });
            })
            .unwrap();
        operator.subscriptions.push(heard);
        operator.diagnostics = diagnostics;
        operator
    }

    pub(super) fn listen<T: Message>(&mut self, topic: &str, qos: Qos) -> Receiver<T> {
        let (send, receive) = channel();
        let heard = self.node.subscribe::<T>(topic, qos, move |message, _| {
            let _ = send.send(message);
        });
        self.subscriptions.push(heard.unwrap());
        receive
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Starts the node on the device `tty` with a bundle for one contact; its log goes to the file `log`.
    pub(super) fn start(&self, skin: &Path, arguments: &[&str]) -> Peer {
        self.start_with(skin, &bundle(self.folder.path(), Settings::new(TIP, 40.0)), arguments)
    }

    /// The same with another bundle.
    pub(super) fn start_with(&self, skin: &Path, model: &Path, arguments: &[&str]) -> Peer {
        let mut command = Command::new(program("dermis"));
        command.current_dir(root()).args(["hapdef", "--source"]);
        command.arg(format!("serial://{}?baud=115200", self.path("tty").display())).arg("--skin").arg(skin);
        command.arg("--model").arg(model).args(arguments);
        Peer::start(command.stderr(File::create(self.path("log")).unwrap()))
    }

    pub(super) fn hears<T: std::fmt::Debug>(
        &self,
        from: &Receiver<T>,
        what: &str,
        mut fits: impl FnMut(&T) -> bool,
    ) -> T {
        let deadline = Instant::now() + SOON;
        let mut last = None;
        loop {
            match from.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(message) if fits(&message) => return message,
                Ok(message) => last = Some(message),
                Err(_) => {
                    let log = std::fs::read_to_string(self.path("log")).unwrap();
                    panic!("nothing said {what}; the last: {last:#?}\n{log}")
                }
            }
        }
    }

    pub(super) fn contacts_say(&self, what: &str, fits: impl FnMut(&ContactArray) -> bool) -> ContactArray {
        self.hears(&self.contacts, what, fits)
    }
}

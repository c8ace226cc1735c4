use std::path::PathBuf;

use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;

/// A program with one kind of node, whose only parameter is `rate`, and one command.
struct Fake;

impl Host for Fake {
    fn program(&self) -> &Path {
        Path::new("/bin/dermis")
    }

    fn check(&self, arguments: &[String]) -> Result<(), String> {
        match arguments.first().map(String::as_str) {
            Some("pad" | "device") => Ok(()),
            other => Err(format!("there is no command {other:?}")),
        }
    }

    fn can_share(&self, arguments: &[String]) -> bool {
        arguments.first().is_some_and(|command| command == "pad")
    }

    fn network(&self, text: &str) -> Result<(), String> {
        ["loopback", "lan", "off", "10.0.0.1"]
            .contains(&text)
            .then_some(())
            .ok_or(format!("`{text}` is no network"))
    }

    fn node(&self, request: &NodeRequest<'_>) -> Result<Value, Vec<Refusal>> {
        let unknown = request.parameters.keys().filter(|name| *name != "rate");
        let refusals: Vec<Refusal> = unknown
            .map(|name| Refusal {
                field: format!("parameters.{name}"),
                reason: "there is only `rate`".into(),
            })
            .collect();
        if !refusals.is_empty() {
            return Err(refusals);
        }
        Ok(json!({
            "name": request.name, "namespace": request.namespace, "domain": request.domain_id,
            "parameters": request.parameters, "config": request.config,
        }))
    }
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    fn load(&self, text: &str, arguments: &[&str]) -> Result<Plan, String> {
        let path = self.file("robot.yaml", text);
        self.open(&path, arguments)
    }

    fn open(&self, path: &Path, arguments: &[&str]) -> Result<Plan, String> {
        let arguments: Vec<String> = arguments.iter().map(|a| (*a).to_owned()).collect();
        let tmp = self.0.path().join("tmp");
        std::fs::create_dir_all(&tmp).unwrap();
        load(path, &arguments, &tmp, &Fake)
            .map_err(|e| e.to_string().replace(&self.0.path().display().to_string(), ""))
    }

    fn config(&self, label: &str) -> Value {
        let text = std::fs::read_to_string(self.0.path().join("tmp").join(label)).unwrap();
        serde_json::from_str(&text).unwrap()
    }
}

fn refusal(text: &str) -> String {
    Folder::new().load(text, &[]).unwrap_err()
}

#[test]
fn groups_push_namespaces_and_defaults() {
    let folder = Folder::new();
    let plan = folder
        .load(
            "
namespace: robot
domain_id: 3
environment: {A: outer, B: outer}
log: debug
processes:
  - group:
      namespace: left
      environment: {B: inner}
      processes:
        - {name: pad, node: pad, parameters: {rate: 50}, ready: {line: up}, config: {skin: a.toml}}
        - {name: see, program: sh, after: [pad], domain_id: 4}
  - {name: pad, node: pad, namespace: /elsewhere, environment: {B: own}, after: [robot/left/pad]}
",
            &[],
        )
        .unwrap();
    let labels: Vec<&str> = plan.processes.iter().map(|p| p.label.as_str()).collect();
    assert_eq!(labels, ["robot/left/pad", "robot/left/see", "elsewhere/pad"]);
    let [pad, see, other] = &plan.processes[..] else { panic!() };
    assert_eq!((&see.after, &other.after), (&vec![0], &vec![0]));
    let variable = |p: &Process, name: &str| p.environment.get(name).cloned().unwrap_or_default();
    assert_eq!([pad, see, other].map(|p| variable(p, "ROS_DOMAIN_ID")), ["3", "4", "3"]);
    assert_eq!([pad, see, other].map(|p| variable(p, "B")), ["inner", "inner", "own"]);
    assert_eq!([pad, see].map(|p| variable(p, "DERMIS_LOG_FORMAT")), ["json", ""]);
    assert_eq!(variable(pad, "DERMIS_LOG"), "debug");
    assert_eq!(
        folder.config("robot.left.pad.yaml"),
        json!({"name": "pad", "namespace": "/robot/left", "domain": 3, "parameters": {"rate": 50}, "config": {"skin": "a.toml"}})
    );
    assert_eq!(pad.arguments[..2], ["pad", "--config"]);
}

#[test]
fn toml_says_the_same() {
    let folder = Folder::new();
    let path = folder.file(
        "robot.toml",
        "domain_id = 3\n[arguments]\nrate = 50\n[[processes]]\nname = 'pad'\nnode = 'pad'\nparameters = {rate = '${rate}'}",
    );
    let plan = folder.open(&path, &["rate:=2.5"]).unwrap();
    assert_eq!(plan.processes[0].environment["ROS_DOMAIN_ID"], "3");
    assert_eq!(folder.config("pad.yaml")["parameters"], json!({"rate": 2.5}));
}

#[test]
fn files_include_files_with_arguments() {
    let folder = Folder::new();
    std::fs::create_dir(folder.0.path().join("sub")).unwrap();
    folder.file(
        "sub/one.yaml",
        "
arguments: {port: , skin: {default: pad.toml, path: true, about: its skin}}
processes: [{name: device, dermis: 'device ${skin} ${port} ${here}', restart: always}]
",
    );
    let plan = folder
        .load(
            "
arguments: {first: 1}
processes:
  - include: {file: sub/one.yaml, namespace: a, arguments: {port: '${first}'}}
  - include: {file: sub/one.yaml, namespace: b, arguments: {port: 2, skin: b.toml}}
",
            &["first:=one word"],
        )
        .unwrap();
    let root = folder.0.path().display().to_string();
    assert_eq!(
        plan.processes[0].arguments,
        ["device", &format!("{root}/sub/pad.toml"), "one word", &format!("{root}/sub")]
    );
    assert_eq!(
        plan.processes[1].arguments[1],
        format!("{root}/b.toml"),
        "given paths start where they are given"
    );
    let text = plan.text().replace(&root, "");
    insta::assert_snapshot!(text, @r#"
/robot.yaml: 2 processes to start
  first:=one word
  1  a/device
       dermis device /sub/pad.toml 'one word' /sub
       started again whenever it ends
  2  b/device
       dermis device /b.toml 2 /sub
       started again whenever it ends
"#);
    assert_eq!(plan.json()["processes"][1]["name"], "b/device");

    let missing = folder.load("processes: [{include: {file: sub/one.yaml}}]", &[]).unwrap_err();
    insta::assert_snapshot!(missing, @"launch file /sub/one.yaml: field `arguments.port`: has no default; give it: `port:=VALUE`");
    let unknown = folder
        .load("processes: [{include: {file: sub/one.yaml, arguments: {port: 1, prot: 2}}}]", &[])
        .unwrap_err();
    insta::assert_snapshot!(unknown, @"launch file /sub/one.yaml: argument `prot:=2`: the file declares no argument `prot`; it has port, skin");
    folder.file("sub/loop.yaml", "processes: [{include: {file: ../robot.yaml}}]");
    let endless = folder.load("processes: [{include: {file: sub/loop.yaml}}]", &[]).unwrap_err();
    insta::assert_snapshot!(endless.replace("sub/../", ""), @"launch file /robot.yaml: is included by itself, directly or through others; remove that `include`");
}

#[test]
fn programs_of_ros_get_their_arguments() {
    let plan = Folder::new()
        .load(
            "
namespace: left
log: warn
processes:
  - {name: viewer, program: [sh, a b], ros_args: true, remap: ['contacts:=/c'], parameters: {rate: 5, names: [a, b]}}
",
            &[],
        )
        .unwrap();
    insta::assert_snapshot!(plan.processes[0].arguments.join(" "), @r#"a b --ros-args -r __node:=viewer -r __ns:=/left -r contacts:=/c -p names:=["a","b"] -p rate:=5 --log-level warn"#);
    assert!(plan.processes[0].program.ends_with("sh") && plan.processes[0].program.is_absolute());
}

#[test]
fn the_network_is_handed_to_every_process_and_the_inner_key_wins() {
    let folder = Folder::new();
    let file = folder.file("z.json5", "{}");
    let mut plan = folder
        .load(
            "
network: lan
processes:
  - {name: a, dermis: device}
  - {name: b, program: [sh]}
  - {name: c, dermis: device, network: loopback}
  - {name: d, program: [sh], network: loopback}
  - {group: {zenoh_config: z.json5, processes: [{name: e, dermis: device}, {name: f, program: [sh]}]}}
  - {name: g, program: [sh], network: 10.0.0.1}
",
            &[],
        )
        .unwrap();
    let of = |plan: &Plan, label: &str, name: &str| {
        plan.processes.iter().find(|p| p.label == label).unwrap().environment.get(name).cloned()
    };
    let range = "ROS_AUTOMATIC_DISCOVERY_RANGE";
    assert_eq!(of(&plan, "a", "DERMIS_NETWORK").as_deref(), Some("lan"));
    assert_eq!(of(&plan, "b", range).as_deref(), Some("SUBNET"));
    assert_eq!(of(&plan, "b", "DERMIS_NETWORK"), None);
    assert_eq!(of(&plan, "c", "DERMIS_NETWORK").as_deref(), Some("loopback"));
    assert_eq!(of(&plan, "d", range).as_deref(), Some("LOCALHOST"));
    let path = file.display().to_string();
    assert_eq!(of(&plan, "e", "DERMIS_ZENOH_CONFIG"), Some(path.clone()));
    assert_eq!(
        of(&plan, "e", "DERMIS_NETWORK").as_deref(),
        Some(""),
        "what the launch received is taken away"
    );
    assert_eq!(of(&plan, "f", "ZENOH_SESSION_CONFIG_URI"), Some(path));
    assert_eq!(of(&plan, "g", range), None, "ROS 2 cannot be given an address");
    for process in &mut plan.processes {
        process.set_network(true, "loopback");
    }
    assert_eq!(of(&plan, "a", "DERMIS_NETWORK").as_deref(), Some("loopback"));
    assert_eq!(of(&plan, "e", "DERMIS_ZENOH_CONFIG").as_deref(), Some(""));
    assert_eq!(of(&plan, "b", range).as_deref(), Some("LOCALHOST"));
    insta::assert_snapshot!(refusal("network: wan\nprocesses: [{name: a, dermis: device}]"), @"launch file /robot.yaml: field `network`: `wan` is no network");
    insta::assert_snapshot!(refusal("network: lan\nzenoh_config: z\nprocesses: [{name: a, dermis: device}]"), @"launch file /robot.yaml: field `network`: stands beside `zenoh_config`, which says all of it; leave one");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, zenoh_config: z}]"), @"launch file /robot.yaml: field `processes[0].zenoh_config`: /z is no file; check the path");
}

#[test]
fn refusals_name_file_and_field() {
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, retsart: always}]"), @"launch file /robot.yaml: field `processes[0].retsart`: unknown field `retsart`, expected one of `name`, `node`, `dermis`, `program`, `group`, `include`, `config`, `flags`, `parameters`, `remap`, `ros_args`, `namespace`, `environment`, `domain_id`, `network`, `zenoh_config`, `log`, `container`, `directory`, `after`, `ready`, `restart`, `backoff`, `required`, `stop`");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, restart: sometimes}]"), @"launch file /robot.yaml: field `processes[0].restart`: unknown variant `sometimes`, expected one of `never`, `on-failure`, `always`");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, backoff: {first: soon}}]"), @r#"launch file /robot.yaml: field `processes[0].backoff.first`: invalid type: string "soon", expected f64"#);
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, backoff: {most: 0.1}}]"), @"launch file /robot.yaml: field `processes[0].backoff.most`: 0.1 s is less than the first wait of 0.5 s; raise it");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: devise}]"), @r#"launch file /robot.yaml: field `processes[0].dermis`: there is no command Some("devise")"#);
    insta::assert_snapshot!(refusal("processes: [{name: a, node: pad, parameters: {raet: 3}}]"), @"launch file /robot.yaml: field `processes[0].parameters.raet`: there is only `rate`");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, parameters: {rate: 3}}]"), @"launch file /robot.yaml: field `processes[0].parameters`: only a `node`, or a `program` with `ros_args: true`, takes this");
    insta::assert_snapshot!(refusal("processes: [{name: a}]"), @"launch file /robot.yaml: field `processes[0]`: says not what to start; give one of `node`, `dermis`, `program`, `group`, `include`");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, program: sh}]"), @"launch file /robot.yaml: field `processes[0]`: says twice what to start; leave one of `node`, `dermis`, `program`");
    insta::assert_snapshot!(refusal("processes: [{name: a-b, node: pad}]"), @"launch file /robot.yaml: field `processes[0].name`: `a-b` is no name; it begins with a letter and goes on with letters, digits, `_`");
    insta::assert_snapshot!(refusal("processes: [{name: a, program: surely-not-installed}]"), @"launch file /robot.yaml: field `processes[0].program[0]`: `surely-not-installed` is not on PATH; install it, or give its path");
    insta::assert_snapshot!(refusal("processes: [{name: a, program: ./missing}]"), @"launch file /robot.yaml: field `processes[0].program[0]`: /./missing is no program; check the path and its permissions");
    insta::assert_snapshot!(refusal("processes: [{group: {processes: [{name: a, dermis: '${none}'}]}}]"), @"launch file /robot.yaml: field `processes[0].group.processes[0].dermis[0]`: `${none}` is not known; declare it under `arguments`, or use one of cwd, here, tmp, env:NAME");
    insta::assert_snapshot!(refusal("processes: [{group: {processes: []}, namespace: a}]"), @r"
2 mistakes:
  launch file /robot.yaml: field `processes[0].namespace`: stands beside `group`; move it into the `group`, or remove it
  launch file /robot.yaml: field `processes[0].group.processes`: is empty; give at least one process
");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, ready: {within: 3}}]"), @"launch file /robot.yaml: field `processes[0].ready`: needs one of `file` and `line`");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, ready: {line: '('}}]"), @"launch file /robot.yaml: field `processes[0].ready.line`: is no regular expression: regex parse error: ( ^ error: unclosed group");
    insta::assert_snapshot!(refusal("namespace: 3a\nprocesses: [{name: a, dermis: device}]"), @"launch file /robot.yaml: field `namespace`: `3a` is no part of a namespace; it begins with a letter and goes on with letters, digits or `_`");
    insta::assert_snapshot!(refusal("domain_id: 500\nprocesses: [{name: a, dermis: device}]"), @"launch file /robot.yaml: field `domain_id`: 500 is no ROS domain; give 0 to 232");
    insta::assert_snapshot!(refusal("log: debg\nprocesses: [{name: a, dermis: device}]"), @"launch file /robot.yaml: field `log`: `debg` is no level; give one of off, error, warn, info, debug, trace, or a filter such as `info,dermis_node=debug`");
    insta::assert_snapshot!(refusal("arguments: {tmp: 3}\nprocesses: [{name: a, dermis: device}]"), @"launch file /robot.yaml: field `arguments.tmp`: cannot be the name of an argument: it begins with a letter, goes on with letters, digits, `_`, `-` or `.`, and is none of here, cwd, tmp");
    insta::assert_snapshot!(refusal("arguments: {a: {defualt: 3}}\nprocesses: [{name: a, dermis: device}]"), @"launch file /robot.yaml: field `arguments.a.defualt`: unknown field `defualt`, expected one of `default`, `about`, `path`");
    insta::assert_snapshot!(refusal("namespace: a"), @"launch file /robot.yaml: field `(top level)`: missing field `processes`");
    insta::assert_snapshot!(refusal("processes: ["), @"launch file /robot.yaml: while parsing a node, did not find expected node content at byte 12 line 2 column 1");
    insta::assert_snapshot!(refusal("- a"), @"launch file /robot.yaml: invalid type: sequence, expected a map");
    insta::assert_snapshot!(refusal(""), @"launch file /robot.yaml: field `(top level)`: missing field `processes`");
    insta::assert_snapshot!(Folder::new().open(Path::new("/none.yaml"), &[]).unwrap_err(), @"launch file /none.yaml: cannot be read: No such file or directory (os error 2); check the path and its permissions");
    insta::assert_snapshot!(Folder::new().load("processes: [{name: a, dermis: device}]", &["x"]).unwrap_err(), @"launch file /robot.yaml: argument `x`: is none; write `name:=value`");
    insta::assert_snapshot!(Folder::new().load("processes: [{name: a, dermis: device}]", &["x:=1"]).unwrap_err(), @"launch file /robot.yaml: argument `x:=1`: the file declares no argument `x`; it has none");
}

#[test]
fn names_and_waits_are_checked_over_all_files() {
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device}, {group: {processes: [{name: a, node: pad}]}}]"), @"launch file /robot.yaml: field `processes[1].group.processes[0].name`: `a` is the name of processes[0] in /robot.yaml too; give one of them another name or namespace");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, after: [b]}]"), @"launch file /robot.yaml: field `processes[0].after[0]`: there is no process `b`; there are a");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device}, {name: b, dermis: device, after: [a]}]"), @"launch file /robot.yaml: field `processes[1].after[0]`: `a` says not when it is ready; give it `ready: {file: …}` or `ready: {line: …}`");
    insta::assert_snapshot!(refusal("
processes:
  - {name: a, dermis: device, ready: {file: x}, after: [c]}
  - {name: b, dermis: device, ready: {file: x}, after: [a]}
  - {name: c, dermis: device, ready: {file: x}, after: [b]}
"), @r"
3 mistakes:
  launch file /robot.yaml: field `processes[0].after[0]`: `c` waits for `a` itself, so that neither would start
  launch file /robot.yaml: field `processes[1].after[0]`: `a` waits for `b` itself, so that neither would start
  launch file /robot.yaml: field `processes[2].after[0]`: `b` waits for `c` itself, so that neither would start
");
    insta::assert_snapshot!(refusal("processes: [{name: a, dermis: device, ready: {file: x}, after: [a]}]"), @"launch file /robot.yaml: field `processes[0].after[0]`: `a` waits for `a` itself, so that neither would start");
}

proptest! {
    #[test]
    fn no_file_panics(text in "(processes|name|dermis|group|include|arguments|after|ready|config|: |- |\\[|\\]|\\{|\\}|,|\n|  |\\$\\{|a|3|\"|'|&|\\*){0,40}") {
        let _ = Folder::new().load(&text, &[]);
    }
}

#[test]
fn every_key_is_explained() {
    let guide = include_str!("../../../../launch/README.md");
    let keys = [
        "unknown: 1\nprocesses: []",
        "processes: [{unknown: 1}]",
        "processes: [{group: {unknown: 1}}]",
        "processes: [{include: {unknown: 1}}]",
        "processes: [{name: a, dermis: device, ready: {unknown: 1}}]",
        "processes: [{name: a, dermis: device, backoff: {unknown: 1}}]",
        "processes: [{name: a, dermis: device, stop: {unknown: 1}}]",
        "arguments: {a: {unknown: 1}}\nprocesses: []",
    ]
    .map(refusal);
    for sentence in keys {
        let line = sentence.lines().find(|line| line.contains("unknown field")).unwrap_or(&sentence);
        let (_, known) = line.split_once("expected ").unwrap_or_else(|| panic!("{sentence}"));
        for key in known.split('`').skip(1).step_by(2) {
            assert!(guide.contains(&format!("`{key}`")), "launch/README.md does not explain `{key}`");
        }
    }
}

const SHARED: &str = "
environment: {A: outer}
container: body
processes:
  - {name: source, dermis: device simulate, ready: {line: up}}
  - {name: other, program: /bin/sh -c true, ready: {line: up}}
  - {name: pad, node: pad, namespace: left, after: [source], config: {skin: a.toml}, flags: [--strict]}
  - {name: alone, node: pad, container: '', after: [left/pad]}
  - {name: pad, node: pad, namespace: right, after: [/source, /other], restart: on-failure, ready: {line: feels}, stop: {interrupt: 9}}
  - {name: last, node: pad, restart: always, required: true, after: [alone]}
";

#[test]
fn nodes_of_a_container_are_one_process() {
    let folder = Folder::new();
    let text = SHARED.replace("after: [left/pad]", "after: [right/pad]").replace(", after: [alone]", "");
    let plan = folder.load(&text, &[]).unwrap();
    let labels: Vec<&str> = plan.processes.iter().map(|p| p.label.as_str()).collect();
    assert_eq!(labels, ["source", "other", "body", "alone"]);
    let (body, alone) = (&plan.processes[2], &plan.processes[3]);
    assert_eq!((&body.after, &alone.after), (&vec![0, 1], &vec![2]));
    assert_eq!((body.restart, body.required, body.stop.interrupt), (Restart::Always, true, 9.0));
    assert!(matches!(&body.ready, Some(Ready::Line { .. })));
    let shown = plan.text().replace(&folder.0.path().display().to_string(), "");
    insta::assert_snapshot!(shown, @r#"
/robot.yaml: 4 processes to start
  1  source
       dermis device simulate
       ready with a line /up/
  2  other
       /bin/sh -c true
       ready with a line /up/
  3  body
       left/pad: dermis pad --config /tmp/left.pad.yaml --strict
       {"config":{"skin":"a.toml"},"name":"pad","namespace":"/left"}
       right/pad: dermis pad --config /tmp/right.pad.yaml
       {"name":"pad","namespace":"/right"}
       last: dermis pad --config /tmp/last.yaml
       {"name":"last","namespace":"/"}
       after source, other; ready with a line /feels/; started again whenever it ends; required
  4  alone
       dermis pad --config /tmp/alone.yaml
       {"name":"alone","namespace":"/"}
       after body
"#);
    assert_eq!(plan.json()["processes"][2]["nodes"][1]["name"], "right/pad");

    // What the command line says of the network is for nodes that have not said it themselves.
    let mut body = body.clone();
    body.set_option("--network", "lan", &["--network", "--strict"]);
    assert_eq!(body.arguments.iter().filter(|word| *word == "--network").count(), 2);
    assert_eq!(body.arguments.iter().filter(|word| *word == "--").count(), 2);
}

#[test]
fn nodes_that_cannot_share_a_process_are_named() {
    let in_body = |first: &str, second: &str| {
        refusal(&format!(
            "container: body\nprocesses:\n  - {{name: a, node: pad{first}}}\n  - {{name: b, node: pad{second}}}\n"
        ))
    };
    insta::assert_snapshot!(in_body("", ", environment: {A: b}"), @"launch file /robot.yaml: field `processes[1].container`: A is not what it is for `a`, which is in container `body` too; a process has one environment, domain, network and log level");
    insta::assert_snapshot!(in_body(", domain_id: 3", ""), @"launch file /robot.yaml: field `processes[1].container`: ROS_DOMAIN_ID is not what it is for `a`, which is in container `body` too; a process has one environment, domain, network and log level");
    insta::assert_snapshot!(in_body("", ", directory: /"), @"launch file /robot.yaml: field `processes[1].directory`: / is another working directory than , that of `a`, which is in container `body` too; give both the same");
    insta::assert_snapshot!(in_body(", ready: {line: up}", ", after: [a]"), @"launch file /robot.yaml: field `processes[1].after[0]`: `a` is in the same container, whose nodes start together; remove it");
    insta::assert_snapshot!(in_body(", ready: {line: up}", ", ready: {line: up}"), @"launch file /robot.yaml: field `processes[1].ready`: is given twice for container `body`; leave one");
    insta::assert_snapshot!(in_body(", backoff: {limit: 3}", ", backoff: {limit: 4}"), @"launch file /robot.yaml: field `processes[1].backoff`: differs from that of other nodes in container `body`; give it once");
    insta::assert_snapshot!(in_body("", ", flags: [--, x]"), @"launch file /robot.yaml: field `processes[1].container`: has the argument `--`, which separates the nodes of a container; leave one of them away");
    insta::assert_snapshot!(in_body("", ", container: 'no name'"), @"launch file /robot.yaml: field `processes[1].container`: `no name` is no name; it begins with a letter and goes on with letters, digits, `_`, `-` or `.`");
    let program = "processes: [{name: a, program: sleep 1, container: body}]";
    insta::assert_snapshot!(refusal(program), @"launch file /robot.yaml: field `processes[0].container`: shares its process with others, which only a node can: a skin, `fusion`, `reflex`, `bridge` or `record`");
    let named = "processes: [{name: body, node: pad}, {name: b, node: pad, container: body}]";
    insta::assert_snapshot!(refusal(named), @"launch file /robot.yaml: field `processes[1].container`: `body` is the name of processes[0] in /robot.yaml too; give one of them another name");
    // Neither would start: the container waits for `alone`, which waits for a node in it.
    let circle = SHARED.replace("after: [left/pad]", "after: [right/pad], ready: {line: up}");
    insta::assert_snapshot!(refusal(&circle), @r#"
2 mistakes:
  launch file /robot.yaml: field `processes[3].after[0]`: `right/pad` waits for `alone` itself, so that neither would start
  launch file /robot.yaml: field `processes[5].after[0]`: `alone` waits for `last` itself, so that neither would start
"#);
}

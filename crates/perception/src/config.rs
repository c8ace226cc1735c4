//! The start configuration of the node.
//!
//! A skin file describes a type of skin; `instance`, `frame_id`, `mount`, `source`, `masked` and `correction` describe the one
//! device of that type that a node reads.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dermis_inference::{Limits, RuntimeConfig};
use dermis_node::{NetworkChoice, Reach};
use dermis_skin::{InstanceError, Mount, SkinDescription};
use serde::{Deserialize, Deserializer, Serialize};

use crate::commands::Commands;

/// A configuration that cannot be used, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file cannot be read, or is neither TOML nor YAML.
    #[error("configuration {path}: {reason}")]
    Read {
        /// File that was requested.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A field is missing or has the wrong type.
    #[error("configuration {path}: field `{field}`: {reason}")]
    Field {
        /// File that it came from.
        path: PathBuf,
        /// Path of the field.
        field: String,
        /// What was expected.
        reason: String,
    },
    /// A key that the node does not know: most often a misspelt one.
    #[error("configuration {path}: unknown key `{key}`; remove it or correct its spelling (known here: {})", Config::KEYS.join(", "))]
    UnknownKey {
        /// File that it came from.
        path: PathBuf,
        /// Path of the key.
        key: String,
    },
}

/// The start configuration of the node; a file of it is TOML or YAML.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// Skin description file; relative to the configuration file where it comes from one.
    pub skin: PathBuf,
    /// Where the bytes come from, e.g. `serial:///dev/ttyACM0?baud=921600`.
    pub source: String,
    /// Node name; the skin's name where absent.
    #[serde(default)]
    pub name: Option<String>,
    /// ROS namespace.
    #[serde(default = "root")]
    pub namespace: String,
    /// Name of this device, unique on the robot: what messages, keys of the bridge, diagnostics and recordings call it. See
    /// [`instance_name`](Self::instance_name) for what it is where absent.
    #[serde(default)]
    pub instance: Option<String>,
    /// Coordinate frame of this device; that of the skin file where absent.
    #[serde(default)]
    pub frame_id: Option<String>,
    /// Where this device is fixed on the robot: pose of its coordinate frame in that of a link.
    #[serde(default)]
    pub mount: Option<Mount>,
    /// Folders of model bundles, each of which gives some of the outputs; relative as `skin` is.
    #[serde(default)]
    pub models: Vec<PathBuf>,
    /// Whether contacts are looked for on the skin's forward model alone where `models` names no bundle: by maximum likelihood, for
    /// the tip and the forces that the skin is rated for.
    #[serde(default)]
    pub invert: bool,
    /// Folders below which `~/load_model` finds bundles; relative as `skin` is. Those that contain `models` where absent.
    #[serde(default)]
    pub model_folders: Option<Vec<PathBuf>>,
    /// What a bundle may cost before it is refused.
    #[serde(default)]
    pub model_limits: Limits,
    /// Commands that are obeyed: `"all"`, `"none"`, or a list of groups.
    #[serde(default)]
    pub commands: Commands,
    /// Where results that take seconds to compute are kept.
    #[serde(default)]
    pub cache: CacheConfig,
    /// Channels to leave out.
    #[serde(default)]
    pub masked: Vec<String>,
    /// How this device differs from the forward model of its type, in place of what the bundles say: a `correction.json` of
    /// `dermis refine --correct`; relative as `skin` is.
    #[serde(default)]
    pub correction: Option<PathBuf>,
    /// What evaluates the models.
    #[serde(default)]
    pub runtime: RuntimeConfig,
    /// \[N\] contacts that press less are not reported; 0 reports whatever stands out of the noise.
    #[serde(default)]
    pub force_threshold: f64,
    /// Whether a model that cannot be used ends the node; otherwise it publishes readings, and says why it gives no
    /// contacts.
    #[serde(default)]
    pub strict: bool,
    /// Whether the node configures and activates itself; otherwise a lifecycle manager does.
    #[serde(default = "yes")]
    pub autostart: bool,
    /// ROS domain; `ROS_DOMAIN_ID` where absent.
    #[serde(default)]
    pub domain_id: Option<u16>,
    /// Who can reach the node: `loopback`, `lan`, `off`, or an address of this machine. The environment decides where
    /// absent, and programs of this machine only where it says nothing.
    #[serde(default)]
    pub network: Option<Reach>,
    /// A zenoh configuration file that says so instead; relative as `skin` is.
    #[serde(default)]
    pub zenoh_config: Option<PathBuf>,
    /// An older way to write `network`: `true` is `loopback`, `false` is `lan`.
    #[serde(default)]
    pub localhost_only: Option<bool>,
    /// Whether stamps are those of `/clock`.
    #[serde(default)]
    pub use_sim_time: bool,
    /// Whether stamps follow the device's clock as it is, from its first frame on, instead of being mapped to the clock
    /// of this machine: for recordings that are played at another pace than they were made at.
    #[serde(default)]
    pub device_time: bool,
    /// Remappings of topics and services, `from:=to`.
    #[serde(default)]
    pub remap: Vec<String>,
    /// Start values of parameters, e.g. `contact_threshold`.
    #[serde(default)]
    pub parameters: BTreeMap<String, serde_json::Value>,
}

/// Where results that take seconds to compute are kept from one start to the next.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(from = "PathBuf", into = "PathBuf")]
pub enum CacheConfig {
    /// In the user's folder for such things: `$XDG_CACHE_HOME/dermis`, or else `~/.cache/dermis`.
    #[default]
    Auto,
    /// Nowhere: everything is computed anew.
    Off,
    /// Here.
    Folder(PathBuf),
}

impl From<PathBuf> for CacheConfig {
    fn from(path: PathBuf) -> Self {
        match path.to_str() {
            Some("auto") => Self::Auto,
            Some("off") => Self::Off,
            _ => Self::Folder(path),
        }
    }
}

impl From<CacheConfig> for PathBuf {
    fn from(cache: CacheConfig) -> Self {
        match cache {
            CacheConfig::Auto => "auto".into(),
            CacheConfig::Off => "off".into(),
            CacheConfig::Folder(path) => path,
        }
    }
}

impl CacheConfig {
    /// The folder; `None` for none.
    #[must_use]
    pub fn folder(&self) -> Option<PathBuf> {
        match self {
            Self::Auto => dermis_skin::cache::usual_folder(),
            Self::Off => None,
            Self::Folder(path) => Some(path.clone()),
        }
    }
}

fn root() -> String {
    "/".into()
}

fn yes() -> bool {
    true
}

impl Config {
    /// Every key of a file.
    pub const KEYS: [&str; 27] = [
        "skin",
        "source",
        "name",
        "namespace",
        "instance",
        "frame_id",
        "mount",
        "models",
        "invert",
        "model_folders",
        "model_limits",
        "commands",
        "cache",
        "masked",
        "correction",
        "runtime",
        "force_threshold",
        "strict",
        "autostart",
        "domain_id",
        "network",
        "zenoh_config",
        "localhost_only",
        "use_sim_time",
        "device_time",
        "remap",
        "parameters",
    ];

    /// A node for this skin and source, with everything else as it is by default.
    #[must_use]
    pub fn new(skin: impl Into<PathBuf>, source: impl Into<String>) -> Self {
        Self {
            skin: skin.into(),
            source: source.into(),
            name: None,
            namespace: root(),
            instance: None,
            frame_id: None,
            mount: None,
            models: Vec::new(),
            invert: false,
            model_folders: None,
            model_limits: Limits::default(),
            commands: Commands::default(),
            cache: CacheConfig::default(),
            masked: Vec::new(),
            correction: None,
            runtime: RuntimeConfig::default(),
            force_threshold: 0.0,
            strict: false,
            autostart: true,
            domain_id: None,
            network: None,
            zenoh_config: None,
            localhost_only: None,
            use_sim_time: false,
            device_time: false,
            remap: Vec::new(),
            parameters: BTreeMap::new(),
        }
    }

    /// Reads a file: YAML where its name ends in `.yaml` or `.yml`, otherwise TOML.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] names the file and the field or key.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, ConfigError> {
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT).map_err(|e| ConfigError::Read {
            path: path.to_owned(),
            reason: format!("cannot be read: {e}; check the path and its permissions"),
        })?;
        let yaml = path.extension().is_some_and(|e| e == "yaml" || e == "yml");
        let mut config = Self::parse(&text, yaml, path)?;
        config.place(path.parent().unwrap_or(Path::new("")));
        Ok(config)
    }

    /// Reads a part of another file: `tree` as it stands in `path`, with paths relative to `folder`.
    ///
    /// # Errors
    ///
    /// [`ConfigError`] names the file and the field or key within `tree`.
    pub fn from_json(tree: serde_json::Value, path: &Path, folder: &Path) -> Result<Self, ConfigError> {
        let mut config = Self::read(tree, path)?;
        config.place(folder);
        Ok(config)
    }

    /// Makes its paths relative to a folder.
    fn place(&mut self, folder: &Path) {
        self.skin = folder.join(&self.skin);
        let folders = self.model_folders.iter_mut().flatten();
        for path in self.models.iter_mut().chain(&mut self.correction).chain(folders) {
            *path = folder.join(&path);
        }
        if let CacheConfig::Folder(path) = &mut self.cache {
            *path = folder.join(&path);
        }
        if let Some(file) = &mut self.zenoh_config {
            *file = folder.join(&file);
        }
    }

    /// What it says of who can reach the node.
    #[must_use]
    pub fn network_choice(&self) -> NetworkChoice {
        let older = self.localhost_only.map(|only| if only { Reach::Loopback } else { Reach::Lan });
        // An older key beside a file says nothing that the file does not.
        let older = older.filter(|_| self.zenoh_config.is_none());
        NetworkChoice { network: self.network.or(older), zenoh_config: self.zenoh_config.clone() }
    }

    /// Name of the node: ROS names have no `-`.
    pub(crate) fn node_name(&self, skin: &SkinDescription) -> String {
        self.name.clone().unwrap_or_else(|| skin.type_name().replace('-', "_"))
    }

    /// Name of the device: `instance` where given; the skin file's name where the node is in the root namespace and is called
    /// like the file; otherwise the node's full name, with `_` between its parts (`palm` in `/gripper/left` is
    /// `gripper_left_palm`). So two skins of one file have two names as long as their nodes have.
    #[must_use]
    pub fn instance_name(&self, skin: &SkinDescription) -> String {
        if let Some(name) = &self.instance {
            return name.clone();
        }
        let parts = self.namespace.split('/').filter(|part| !part.is_empty());
        let node = self.node_name(skin);
        let name = parts.chain([node.as_str()]).collect::<Vec<_>>().join("_");
        if name == skin.type_name().replace('-', "_") { skin.type_name().to_owned() } else { name }
    }

    /// The skin file as the device that this node reads.
    ///
    /// # Errors
    ///
    /// [`InstanceError`] names the key that cannot be used.
    pub fn instance_of(&self, skin: SkinDescription) -> Result<SkinDescription, InstanceError> {
        let name = self.instance_name(&skin);
        skin.into_instance(Some(&name), self.frame_id.as_deref(), self.mount.as_ref())
    }

    fn parse(text: &str, yaml: bool, path: &Path) -> Result<Self, ConfigError> {
        if yaml {
            dermis_io::yaml::check(text, dermis_io::yaml::Budget::WRITTEN)
                .map_err(|reason| ConfigError::Read { path: path.to_owned(), reason })?;
        }
        let format = if yaml { ::config::FileFormat::Yaml } else { ::config::FileFormat::Toml };
        let tree =
            ::config::Config::builder().add_source(::config::File::from_str(text, format)).build().map_err(
                |e| ConfigError::Read { path: path.to_owned(), reason: dermis_io::one_line(&e.to_string()) },
            )?;
        Self::read(tree, path)
    }

    fn read<'de, D: Deserializer<'de>>(tree: D, path: &Path) -> Result<Self, ConfigError> {
        let mut unknown = None;
        let mut track = serde_path_to_error::Track::new();
        let parsed: Result<Self, D::Error> = {
            let path_aware = serde_path_to_error::Deserializer::new(tree, &mut track);
            serde_ignored::deserialize(path_aware, |key| {
                unknown.get_or_insert_with(|| key.to_string());
            })
        };
        // A misspelt key is the likely reason for a missing one, so that it comes first.
        if let Some(key) = unknown {
            return Err(ConfigError::UnknownKey { path: path.to_owned(), key });
        }
        // An argument of a launch file that is empty where it is not given.
        let given = |text: Option<String>| text.filter(|text| !text.is_empty());
        let parsed = parsed.map(|config| Self {
            instance: given(config.instance.clone()),
            frame_id: given(config.frame_id.clone()),
            ..config
        });
        parsed.map_err(|e| ConfigError::Field {
            path: path.to_owned(),
            field: match track.path().to_string() {
                path if path == "." => "(top level)".into(),
                path => path,
            },
            reason: dermis_io::one_line(&e.to_string()),
        })
    }
}

#[cfg(test)]
mod tests;

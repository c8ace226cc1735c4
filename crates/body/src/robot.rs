//! The robot file: a URDF and the skins on its links.
//!
//! ```toml
//! schema = "dermis-robot/1"
//! name = "humanoid"
//! urdf = "humanoid.urdf"       # xacro expanded; relative to this file, as all paths here
//! srdf = "humanoid.srdf"       # says which links may touch each other; may be absent
//! base = "pelvis"              # body frame; the root of the URDF where absent
//!
//! [[skins]]
//! name = "left_palm"           # of the device, unique on the robot: what its messages call it
//! skin = "../skins/baro-grid.toml"   # its type; or `taxels`, a table of positions
//! namespace = "/humanoid/left_palm"  # of its node; `/left_palm` where absent
//! frame_id = "left_palm_skin"  # of its messages; `left_palm_skin` where absent
//! mount = { parent = "left_hand", translation = [0.0, 0.01, 0.04], rpy = [-1.5708, 0.0, 0.0] }
//! timeout = 0.2                # [s] without a message after which it is stale
//! rate = 100.0                 # [Hz] of its frames; that of the file `skin` where absent
//! ```
//!
//! A skin whose frame is a link of the URDF itself has no `mount`. Of the file `skin`, reading a robot takes `rate` only, and not
//! even that where it stands here.

use std::collections::hash_map::Entry;
use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use dermis_io::toml::Fault;
use dermis_skin::{Mount, SkinDescription, SkinError, is_frame, is_name};
use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::body::Body;
use crate::srdf;
use crate::taxel_table;
use crate::urdf::UrdfError;

/// What the file's `schema` has to be.
const SCHEMA: &str = "dermis-robot/1";
/// Keys of a file and, behind `skins`, of a skin.
const KNOWN: &str = "schema, name, urdf, srdf, base, skins; \
    in skins: name, skin, taxels, namespace, frame_id, mount, timeout, rate";
/// Skins on one robot.
const MOST_SKINS: usize = 1024;
/// \[Hz\] of frames.
const RATES: std::ops::RangeInclusive<f64> = 1e-3..=1e6;

/// Why a robot file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RobotError {
    /// A file cannot be read.
    #[error("robot file {path}: cannot be read: {source}; check the path and its permissions")]
    Read {
        /// File that was requested.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A field is missing, has the wrong type or cannot be.
    #[error("robot file {file}: field `{field}`: {reason}")]
    Field {
        /// What errors call the file.
        file: String,
        /// Path of the field.
        field: String,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// A key that is not known: most often a misspelt one.
    #[error(
        "robot file {file}: unknown key `{key}`; remove it or correct its spelling (known here: {KNOWN})"
    )]
    UnknownKey {
        /// What errors call the file.
        file: String,
        /// Path of the key.
        key: String,
    },
    /// The URDF or the SRDF cannot be used.
    #[error(transparent)]
    Urdf(#[from] UrdfError),
    /// A skin file cannot be used.
    #[error(transparent)]
    Skin(#[from] SkinError),
}

#[derive(Debug, Serialize, Deserialize)]
struct RobotFile {
    schema: String,
    name: String,
    urdf: PathBuf,
    srdf: Option<PathBuf>,
    base: Option<String>,
    #[serde(default)]
    skins: Vec<SkinEntry>,
}

#[derive(Debug, Serialize, Deserialize)]
struct SkinEntry {
    name: String,
    skin: Option<PathBuf>,
    taxels: Option<PathBuf>,
    namespace: Option<String>,
    frame_id: Option<String>,
    mount: Option<Mount>,
    #[serde(default = "usual_timeout")]
    timeout: f64,
    rate: Option<f64>,
}

fn usual_timeout() -> f64 {
    0.2
}

/// One skin on a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct SkinOnBody {
    /// Name of the device, unique on the robot.
    pub name: String,
    /// File of its type, where it has one.
    pub skin: Option<PathBuf>,
    /// Table of its taxels, where it has one.
    pub taxels: Option<PathBuf>,
    /// Namespace of its node, absolute.
    pub namespace: String,
    /// Coordinate frame of its messages.
    pub frame_id: String,
    /// Link that it is fixed to.
    pub link: usize,
    /// `link_from_skin`.
    pub pose: Isometry3<f64>,
    /// \[s\] without a message after which it is stale.
    pub timeout: f64,
    /// \[Hz\] of its frames: what the robot file states, or the file of its type; `None` where neither does.
    pub rate: Option<f64>,
}

/// A robot and its skins.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Name of the robot.
    pub name: String,
    /// Its links and joints.
    pub body: Body,
    /// Link whose frame is the body frame.
    pub base: usize,
    /// Its skins, in the order of the file.
    pub skins: Vec<SkinOnBody>,
    /// Pairs of links with skins that may touch each other, by the SRDF; the smaller index first. Empty where the file names no
    /// SRDF.
    pub self_contact: Vec<[usize; 2]>,
}

/// A taxel on a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyTaxel {
    /// Index of its skin.
    pub skin: usize,
    /// Index in that skin.
    pub index: usize,
    /// \[m\] in the frame of the skin's link.
    pub position: Point3<f64>,
    /// Unit, out of the skin, in the frame of its link; `None` where not known.
    pub normal: Option<Vector3<f64>>,
}

impl Robot {
    /// Reads a robot file, the URDF and the SRDF that it names, and the rates that the files of its skins state.
    ///
    /// # Errors
    ///
    /// [`RobotError`] names the file and the field, or what is wrong with the URDF or the SRDF.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, RobotError> {
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT)
            .map_err(|source| RobotError::Read { path: path.to_owned(), source })?;
        Self::from_toml(&text, path)
    }

    /// Reads the text of a robot file that is, or could be, at `path`: paths in it are relative to its folder.
    ///
    /// # Errors
    ///
    /// As [`load`](Self::load).
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, RobotError> {
        let file = path.display().to_string();
        let folder = path.parent().unwrap_or(Path::new(""));
        let read = parse(text, &file)?;
        let wrong = |field: &str, reason: String| field_error(&file, field, reason);
        if read.schema != SCHEMA {
            return Err(wrong(
                "schema",
                format!("is \"{}\" where this program reads \"{SCHEMA}\"", read.schema),
            ));
        }
        if !is_name(&read.name) {
            return Err(wrong(
                "name",
                format!("\"{}\" is no name: take letters, digits, `_` and `-`", read.name),
            ));
        }
        if read.skins.len() > MOST_SKINS {
            return Err(wrong(
                "skins",
                format!("has {} and may have {MOST_SKINS} at most", read.skins.len()),
            ));
        }
        let body = Body::load(folder.join(&read.urdf))?;
        let base = match &read.base {
            None => body.root(),
            Some(name) => body
                .link(name)
                .ok_or_else(|| wrong("base", format!("\"{name}\" is no link of {}", read.urdf.display())))?,
        };
        let mut skins: Vec<SkinOnBody> = Vec::with_capacity(read.skins.len());
        let mut taken: HashMap<String, usize> = HashMap::new();
        // A file that many skins are of is read once.
        let mut rates: HashMap<PathBuf, f64> = HashMap::new();
        for (i, entry) in read.skins.into_iter().enumerate() {
            let mut skin = place(&body, entry, folder)
                .map_err(|(key, reason)| wrong(&format!("skins[{i}].{key}"), reason))?;
            if let (None, Some(path)) = (skin.rate, &skin.skin) {
                skin.rate = Some(match rates.entry(path.clone()) {
                    Entry::Occupied(known) => *known.get(),
                    Entry::Vacant(unknown) => *unknown.insert(SkinDescription::rate_of(path)?),
                });
            }
            for (key, value) in
                [("name", &skin.name), ("frame_id", &skin.frame_id), ("namespace", &skin.namespace)]
            {
                if let Some(other) = taken.insert(format!("{key} {value}"), i) {
                    let reason =
                        format!("\"{value}\" is that of skins[{other}] already; each device has its own");
                    return Err(wrong(&format!("skins[{i}].{key}"), reason));
                }
            }
            skins.push(skin);
        }
        let carriers: BTreeSet<usize> = skins.iter().map(|skin| skin.link).collect();
        let self_contact =
            read.srdf.map(|srdf| srdf::load(&folder.join(srdf), &body, &carriers)).transpose()?;
        Ok(Self { name: read.name, body, base, skins, self_contact: self_contact.unwrap_or_default() })
    }

    /// All taxels of all skins, from skin files and tables.
    ///
    /// # Errors
    ///
    /// Where a skin file or a table cannot be used, or a skin names neither.
    pub fn taxels(&self) -> Result<Vec<BodyTaxel>, RobotError> {
        let mut all = Vec::new();
        for (s, skin) in self.skins.iter().enumerate() {
            let mut put = |index: usize, position: Point3<f64>, normal: Option<Vector3<f64>>| {
                let (position, normal) = (skin.pose * position, normal.map(|n| skin.pose * n));
                all.push(BodyTaxel { skin: s, index, position, normal });
            };
            match (&skin.skin, &skin.taxels) {
                (_, Some(path)) => {
                    let text = dermis_io::read_text(path, dermis_io::TEXT)
                        .map_err(|source| RobotError::Read { path: path.clone(), source })?;
                    let table = taxel_table::read(&text).map_err(|reason| {
                        field_error(&path.display().to_string(), "[calibration]", reason)
                    })?;
                    for taxel in table {
                        put(taxel.index, taxel.position, taxel.normal);
                    }
                }
                (Some(path), None) => {
                    for (index, taxel) in SkinDescription::load(path)?.taxels.iter().enumerate() {
                        put(index, taxel.point(), Some(Vector3::from(taxel.normal)));
                    }
                }
                (None, None) => {
                    let field = format!("skins[{s}].skin");
                    return Err(field_error(
                        &self.name,
                        &field,
                        "is missing, and so is `taxels`; give one".into(),
                    ));
                }
            }
        }
        Ok(all)
    }
}

fn field_error(file: &str, field: &str, reason: String) -> RobotError {
    RobotError::Field { file: file.to_owned(), field: field.to_owned(), reason }
}

/// The file's keys and values, as they stand there.
fn parse(text: &str, file: &str) -> Result<RobotFile, RobotError> {
    dermis_io::toml::parse(text).map_err(|fault| match fault {
        Fault::UnknownKey { key } => RobotError::UnknownKey { file: file.to_owned(), key },
        fault => {
            let (field, reason) = fault.into_field();
            field_error(file, &field, reason)
        }
    })
}

/// A skin at its place; the key that cannot be, and why.
fn place(body: &Body, entry: SkinEntry, folder: &Path) -> Result<SkinOnBody, (&'static str, String)> {
    let name = entry.name;
    if !is_name(&name) {
        return Err(("name", format!("\"{name}\" is no name of a skin: take letters, digits, `_` and `-`")));
    }
    let frame_id = entry.frame_id.unwrap_or_else(|| format!("{name}_skin"));
    if !is_frame(&frame_id) {
        return Err((
            "frame_id",
            format!("\"{frame_id}\" is no coordinate frame: no leading slash, no spaces"),
        ));
    }
    let (link, pose) = match (body.link(&frame_id), &entry.mount) {
        (Some(link), None) => (link, Isometry3::identity()),
        (Some(_), Some(_)) => {
            return Err((
                "frame_id",
                format!(
                    "\"{frame_id}\" is a link of the URDF, which places it already; take another name, or remove `mount`"
                ),
            ));
        }
        (None, None) => {
            return Err((
                "mount",
                format!(
                    "is missing, and \"{frame_id}\" is no link of the URDF; say which link the skin is fixed to"
                ),
            ));
        }
        (None, Some(mount)) => {
            let link = body.link(mount.parent()).ok_or_else(|| {
                ("mount.parent", format!("\"{}\" is no link of the URDF; correct the name", mount.parent()))
            })?;
            (link, *mount.pose())
        }
    };
    let namespace = entry.namespace.unwrap_or_else(|| format!("/{}", name.replace('-', "_")));
    if !namespace.starts_with('/')
        || namespace.chars().any(|c| !c.is_ascii_alphanumeric() && c != '_' && c != '/')
    {
        return Err((
            "namespace",
            format!(
                "\"{namespace}\" is no absolute namespace: begin with `/`, and take letters, digits and `_`"
            ),
        ));
    }
    if !(1e-3..=3600.0).contains(&entry.timeout) {
        return Err(("timeout", format!("is {} s and must be from 0.001 to 3600", entry.timeout)));
    }
    if let Some(rate) = entry.rate.filter(|rate| !RATES.contains(rate)) {
        return Err(("rate", format!("is {rate} Hz and must be from 0.001 to 1000000")));
    }
    Ok(SkinOnBody {
        skin: entry.skin.map(|path| folder.join(path)),
        taxels: entry.taxels.map(|path| folder.join(path)),
        namespace: namespace.trim_end_matches('/').to_owned(),
        timeout: entry.timeout,
        rate: entry.rate,
        name,
        frame_id,
        link,
        pose,
    })
}

#[cfg(test)]
mod tests;

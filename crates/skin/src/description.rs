//! The skin description file: what a skin is, read from TOML, completed, checked, and identified by a hash.
//!
//! `parts` has the tables of the file, `check` fills in what may be left out and refuses what cannot be.

use std::path::Path;
use std::sync::OnceLock;

use dermis_io::toml::Fault;
use dermis_msgs::ChannelLayout;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::family;
use crate::mesh::TriangleMesh;
use crate::{Effect, ModelError, Rated, SkinError, Surface};

pub use parts::{Channel, Condition, SensorKind, SurfaceSpec, Taxel, Wire, WireProtocol, WireSamples};

mod check;
mod parts;

const SCHEMA: &str = "dermis-skin/1";

/// A number that is computed from the rest of a description, so that comparisons leave it out.
#[derive(Debug, Clone, Default)]
struct Layout(OnceLock<(String, u32)>);

impl PartialEq for Layout {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// The content of a skin description file.
///
/// A file is TOML; see `launch/skins/` for examples to copy. Unknown keys are errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SkinDescription {
    schema: String,
    /// Of the type: lower case letters, digits, `-` and `_`. Of the device, unique on the robot, once it is an
    /// [instance](Self::into_instance).
    pub name: String,
    /// Name of the file's, where `name` is that of an instance.
    #[serde(skip)]
    pub(crate) type_name: Option<String>,
    /// What its frames carry, for the unit that it was computed for.
    #[serde(skip)]
    layout: Layout,
    /// Which sensor family reads it: a name in the program's registry.
    pub sensor: String,
    /// Free text.
    #[serde(default)]
    pub description: String,
    /// Where the readings come from.
    #[serde(default)]
    pub kind: SensorKind,
    /// Coordinate frame of every position: the URDF link that the skin is fixed to.
    pub frame_id: String,
    /// Unit of every value: an SI symbol, or `1`.
    pub unit: String,
    /// Frames a second \[Hz\].
    pub rate: f64,
    /// Standard deviation of a channel's noise, in `unit`.
    pub noise: f64,
    /// Range of the device, in `unit`, for channels that name none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// What usually presses it; as the family says where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rated: Option<Rated>,
    /// Framing and raw counts.
    #[serde(default)]
    pub wire: Wire,
    /// Cleaning of raw values.
    #[serde(default)]
    pub condition: Condition,
    /// Shape of the outside.
    #[serde(serialize_with = "family::serialize_surface", deserialize_with = "family::deserialize_surface")]
    pub surface: SurfaceSpec,
    /// Sensing elements; a sensor family may fill them in.
    #[serde(default)]
    pub taxels: Vec<Taxel>,
    /// Numbers of a frame, in order; one a taxel and of its name where absent.
    #[serde(default)]
    channels: Vec<Channel>,
    /// What lies between surface and taxels: read by the sensor family's forward model.
    #[serde(default)]
    pub medium: toml::Table,
    /// What the nominal model leaves out and this device has: read by the sensor family's forward model.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<Effect>,
}

impl SkinDescription {
    /// Reads a skin description file.
    ///
    /// # Errors
    ///
    /// [`SkinError`] says which file and field is wrong and what would be right.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SkinError> {
        let path = path.as_ref();
        let text = dermis_io::read_text(path, dermis_io::TEXT)
            .map_err(|source| SkinError::Read { path: path.to_owned(), source })?;
        Self::from_toml(&text, &path.display().to_string())
    }

    /// Reads a skin description; `file` is what errors call it.
    ///
    /// # Errors
    ///
    /// As [`load`](Self::load).
    pub fn from_toml(text: &str, file: &str) -> Result<Self, SkinError> {
        let mut skin: Self = dermis_io::toml::parse(text).map_err(|fault| match fault {
            Fault::UnknownKey { key } => {
                SkinError::UnknownKey { file: file.to_owned(), key, known: KNOWN_KEYS.join(", ") }
            }
            fault => SkinError::parse(file, fault),
        })?;
        skin.finish(file)?;
        crate::limits::distinct(&skin.taxels).map_err(|(field, reason)| SkinError::Impossible {
            file: file.to_owned(),
            field,
            reason,
        })?;
        Ok(skin)
    }

    /// \[Hz\] The frames a second that a skin description file states. Nothing else of the file is judged, and no sensor family
    /// is asked.
    ///
    /// # Errors
    ///
    /// [`SkinError`] where the file cannot be read or is no TOML, or where its `rate` is missing or cannot be.
    pub fn rate_of(path: impl AsRef<Path>) -> Result<f64, SkinError> {
        #[derive(Deserialize)]
        struct Stated {
            rate: f64,
        }
        let path = path.as_ref();
        let file = || path.display().to_string();
        let text = dermis_io::read_text(path, dermis_io::TEXT)
            .map_err(|source| SkinError::Read { path: path.to_owned(), source })?;
        let wrong = |fault| SkinError::parse(&file(), fault);
        let mut table = dermis_io::toml::table(&text).map_err(wrong)?;
        table.retain(|key, _| key == "rate");
        let Stated { rate } = dermis_io::toml::of_table(table).map_err(wrong)?;
        let [low, high] = crate::limits::RATE;
        if !(low..=high).contains(&rate) {
            let reason = crate::limits::outside(rate, low, high, "Hz");
            return Err(SkinError::Impossible { file: file(), field: "rate".into(), reason });
        }
        Ok(rate)
    }

    /// The same skin with other sensing elements, one channel each: elements that could be, for placement, or that are only
    /// computed.
    ///
    /// # Errors
    ///
    /// [`SkinError::Impossible`] where an element cannot be, as in a file.
    pub fn with_taxels(&self, taxels: Vec<Taxel>) -> Result<Self, SkinError> {
        let mut skin = Self { taxels, channels: Vec::new(), layout: Layout::default(), ..self.clone() };
        skin.finish(&format!("{}, with other taxels", self.name))?;
        Ok(skin)
    }

    /// [`medium`](Self::medium) as the type of a sensor family.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] with the field `medium.…` that is missing, unknown or of another type.
    pub fn medium_as<T: serde::de::DeserializeOwned>(&self) -> Result<T, ModelError> {
        dermis_io::toml::of_table(self.medium.clone()).map_err(|fault| {
            let (field, reason) = fault.into_field_of("medium");
            self.refusal(&field, reason)
        })
    }

    /// What a model says of a field of this skin that it cannot take.
    #[must_use]
    pub fn refusal(&self, field: &str, reason: String) -> ModelError {
        ModelError::Description { skin: self.name.clone(), field: field.to_owned(), reason }
    }

    /// Checks [`medium`](Self::medium) by `read`, the family's reader of that table. A skin without a medium has no forward model,
    /// which is no mistake; neither is one that the family has no model for.
    ///
    /// # Errors
    ///
    /// [`ModelError::Description`] for a field of `medium`.
    pub fn check_medium(&self, read: impl FnOnce() -> Result<(), ModelError>) -> Result<(), ModelError> {
        if self.medium.is_empty() {
            return Ok(());
        }
        match read() {
            Err(error @ ModelError::Description { .. }) if error.is_of_medium() => Err(error),
            _ => Ok(()),
        }
    }

    /// Numbers of a frame, in order. `range` and `noise` have the skin's values filled in.
    #[must_use]
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// Gives the skin these numbers of a frame, for a sensor family that [completes](crate::Family::complete) it.
    pub fn set_channels(&mut self, channels: Vec<Channel>) {
        self.channels = channels;
        self.layout = Layout::default();
    }

    /// Gives the shape that only the sensor family knows its mesh; nothing happens to a skin of another shape.
    pub fn set_shape(&mut self, mesh: TriangleMesh) {
        if let SurfaceSpec::Family(shape) = &mut self.surface {
            shape.mesh = mesh;
        }
    }

    /// Identity of [`channels`](Self::channels) and [`unit`](Self::unit), which each frame carries; see [`ChannelLayout`]. Computed once: frames come often.
    #[must_use]
    pub fn layout_id(&self) -> u32 {
        let names = self.channels.iter().map(|channel| channel.name.as_str());
        let (unit, id) = self
            .layout
            .0
            .get_or_init(|| (self.unit.clone(), ChannelLayout::id_of(&self.unit, names.clone())));
        // The unit can be written from outside.
        if *unit == self.unit { *id } else { ChannelLayout::id_of(&self.unit, names) }
    }

    /// Standard deviation of each channel's noise, in `unit`.
    #[must_use]
    pub fn channel_noise(&self) -> Vec<f64> {
        self.channels.iter().map(|c| c.noise.unwrap_or(self.noise)).collect()
    }

    /// Index of the taxel that each channel belongs to.
    #[must_use]
    pub fn channel_taxels(&self) -> Vec<usize> {
        self.channels
            .iter()
            .map(|c| self.taxels.iter().position(|t| t.name == c.taxel).unwrap_or_default())
            .collect()
    }

    /// The triangulated surface.
    #[must_use]
    pub fn surface(&self) -> Surface {
        Surface::from_spec(&self.surface)
    }

    /// Identity of the type: `sha256:` and 64 hex digits over sensor family, unit, surface, taxels, channels and medium. What
    /// does not change the physics (name, text, rate, wire, cleaning, link) does not change the hash, nor do comments and
    /// formatting; nor do effects, which say what a device of this design is really like, so that a model that was trained on
    /// the design can be tried on the device.
    ///
    /// Names of taxels and channels are covered: where several channels belong to one taxel (the axes of a magnetometer), the
    /// name alone says which number of a frame is which, and recordings are matched by it. Where taxels are is covered to
    /// 0.1 µm: families compute it, and the last digits of a sine are not the same on every machine.
    #[must_use]
    pub fn hash(&self) -> String {
        digest(&self.identity(&self.taxels.iter().map(Taxel::rounded).collect::<Vec<_>>()))
    }

    /// The hashes as earlier versions wrote them: with every digit of the taxels, and before that with the name, too.
    pub(crate) fn earlier_hashes(&self, name: &str) -> [String; 2] {
        let mut identity = self.identity(&self.taxels);
        let exact = digest(&identity);
        identity["name"] = name.into();
        [exact, digest(&identity)]
    }

    fn identity(&self, taxels: &[Taxel]) -> serde_json::Value {
        serde_json::json!({
            "schema": self.schema,
            "sensor": self.sensor,
            "unit": self.unit,
            "surface": self.surface.identity(),
            "taxels": taxels,
            "channels": self.channels,
            "medium": self.medium,
        })
    }
}

fn digest(identity: &serde_json::Value) -> String {
    let digest = Sha256::digest(identity.to_string().as_bytes());
    let hex: String = digest.iter().map(|b| format!("{b:02x}")).collect();
    format!("sha256:{hex}")
}

const KNOWN_KEYS: [&str; 16] = [
    "schema",
    "name",
    "sensor",
    "description",
    "kind",
    "frame_id",
    "unit",
    "rate",
    "noise",
    "range",
    "rated",
    "wire",
    "condition",
    "surface, taxels, channels",
    "medium",
    "effects",
];
#[cfg(test)]
mod tests {
    use super::parts::up;
    use super::*;
    use crate::testing::PAD;

    fn refused(from: &str, to: &str) -> String {
        assert!(PAD.contains(from));
        SkinDescription::from_toml(&PAD.replace(from, to), "pad.toml").unwrap_err().to_string()
    }

    #[test]
    fn channels_follow_taxels_where_none_are_named() {
        let skin = SkinDescription::from_toml(PAD, "pad.toml").unwrap();
        assert_eq!(skin.channels()[1].name, "t1");
        assert_eq!(skin.channel_noise(), [20.0, 20.0]);
        assert_eq!(skin.channel_taxels(), [0, 1]);
    }

    #[test]
    fn a_file_states_its_rate() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pad.toml");
        let stated = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let error = |e: SkinError| e.to_string().replace(&path.display().to_string(), "pad.toml");
            SkinDescription::rate_of(&path).map_err(error)
        };
        assert_eq!(stated(PAD), Ok(SkinDescription::from_toml(PAD, "pad.toml").unwrap().rate));
        assert_eq!(stated("sensor = 'of nobody'\nrate = 40"), Ok(40.0));
        insta::assert_snapshot!(stated("rate = 0.0").unwrap_err(), @"skin file pad.toml: field `rate`: is 0e0 Hz and must be 0.001 to 1000000 Hz");
        insta::assert_snapshot!(stated("sensor = 'x'").unwrap_err(), @"skin file pad.toml: field `(whole file)`: missing field `rate`");
        insta::assert_snapshot!(stated("\nrate = 'fast'").unwrap_err(), @r#"skin file pad.toml: field `rate`: invalid type: string "fast", expected f64"#);
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(SkinDescription::rate_of(&path), Err(SkinError::Read { .. })));
    }

    #[test]
    fn a_skin_can_have_other_taxels() {
        let skin = SkinDescription::from_toml(PAD, "pad.toml").unwrap();
        let mut other = skin.taxels[1].clone();
        other.normal = [0.0, 0.0, 2.0];
        let one = skin.with_taxels(vec![other.clone()]).unwrap();
        assert_eq!((one.channels().len(), one.channels()[0].name.as_str()), (1, "t1"));
        assert_eq!((one.taxels[0].normal, one.channel_noise()), ([0.0, 0.0, 1.0], vec![20.0]));
        let twice = skin.with_taxels(vec![other.clone(), other]).unwrap_err();
        insta::assert_snapshot!(twice, @r#"skin file pad, with other taxels: field `taxels[1].name`: "t1" is already taken"#);
    }

    #[test]
    fn hash_ignores_what_is_not_physics() {
        let hash = |text: &str| SkinDescription::from_toml(text, "pad.toml").unwrap().hash();
        assert_eq!(hash(PAD), hash(&PAD.replace("rate = 100.0", "rate = 50 # slower")));
        assert_eq!(hash(PAD), hash(&PAD.replace("name = \"pad\"", "name = \"left-pad\"")));
        assert_ne!(hash(PAD), hash(&PAD.replace("-0.005] }]", "-0.006] }]")));
        assert_ne!(hash(PAD), hash(&PAD.replace("\"t1\"", "\"t2\"")));
    }

    /// As on a machine whose sine has another last digit.
    #[test]
    fn hash_ignores_the_last_digits_of_taxels() {
        let pad = SkinDescription::from_toml(PAD, "pad.toml").unwrap();
        let moved = |by: f64| {
            let moved = |v: &f64| v * (1.0 + by) - by * 1e-3;
            let taxels =
                pad.taxels.iter().cloned().map(|t| Taxel { position: t.position.each_ref().map(moved), ..t });
            pad.with_taxels(taxels.collect()).unwrap()
        };
        let other = moved(1e-13);
        assert_ne!(pad.taxels, other.taxels);
        assert_eq!(pad.hash(), other.hash());
        assert_ne!(pad.hash(), moved(1e-3).hash());
        // What earlier versions stamped is known on the machine that stamped it.
        assert!(
            other.is_type(&other.earlier_hashes("")[0], "") && !pad.is_type(&other.earlier_hashes("")[0], "")
        );
    }

    #[test]
    fn refusals_name_file_field_and_remedy() {
        insta::assert_snapshot!(refused("noise = 20.0", "noise = -1.0"), @"skin file pad.toml: field `noise`: is -1 and must be a positive number");
        insta::assert_snapshot!(refused("rate = 100.0", "rate = \"fast\""), @r#"skin file pad.toml: field `rate`: invalid type: string "fast", expected f64"#);
        insta::assert_snapshot!(refused("rate = 100.0", "rate = 100.0\nrat = 3"), @"skin file pad.toml: unknown key `rat`; remove it or correct its spelling (known here: schema, name, sensor, description, kind, frame_id, unit, rate, noise, range, rated, wire, condition, surface, taxels, channels, medium, effects)");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\nwire = { protocol = \"ascii\", counts = [4095, 0] }"), @"skin file pad.toml: field `wire.counts`: is [4095, 0] and must be a least and a greater largest count");
        insta::assert_snapshot!(refused("size = [0.02, 0.01]", "size = [0.02, -0.01]"), @"skin file pad.toml: field `surface.size[1]`: is -0.01 m and must be a positive length");
        insta::assert_snapshot!(refused("\"t1\"", "\"t0\""), @r#"skin file pad.toml: field `taxels[1].name`: "t0" is already taken"#);
        insta::assert_snapshot!(refused("dermis-skin/1", "dermis-skin/9"), @r#"skin file pad.toml: field `schema`: is "dermis-skin/9" where this program reads "dermis-skin/1""#);
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\neffects = [{ name = \"gain\", strength = -1.0 }]"), @"skin file pad.toml: field `effects[0].strength`: is -1 and must be 0 (off) or positive");
        insta::assert_snapshot!(refused("noise = 20.0", "noise = 20.0\neffects = [{ name = \"gain\" }, { name = \"gain\", by = 0.2 }]"), @r#"skin file pad.toml: field `effects[1].name`: "gain" is already there"#);
        insta::assert_snapshot!(refused("name = \"pad\"\n", ""), @"skin file pad.toml: field `(whole file)`: missing field `name`");
    }

    proptest::proptest! {
        #[test]
        fn what_is_written_reads_back(
            name in "[a-z0-9_-]{1,12}",
            description in ".{0,30}",
            rate in 1e-3..1e5f64,
            noise in 1e-9..1e9f64,
            scale in 1e-9..1e9f64,
            offset in -1e9..1e9f64,
            ascii in proptest::bool::ANY,
            positions in proptest::collection::vec(proptest::array::uniform3(-1.0..1.0f64), 1..8),
            stuck in 0.0..1e3f64,
        ) {
            let mut skin = SkinDescription::from_toml(include_str!("../../../launch/skins/baro-grid.toml"), "grid").unwrap();
            skin.name = name;
            skin.description = description;
            (skin.rate, skin.noise, skin.condition.stuck_time) = (rate, noise, stuck);
            skin.wire.protocol = if ascii { WireProtocol::Ascii } else { WireProtocol::Native };
            (skin.wire.scale, skin.wire.offset) = (scale, offset);
            let taxels = positions.iter().enumerate();
            skin.taxels = taxels.map(|(i, p)| Taxel { name: format!("t{i}"), position: *p, normal: up(), axis: None }).collect();
            skin.channels.clear();
            skin.finish("written").unwrap();
            let text = toml::to_string(&skin).unwrap();
            proptest::prop_assert_eq!(SkinDescription::from_toml(&text, "written").unwrap(), skin);
        }

        #[test]
        fn no_text_panics(text in ".{0,200}") {
            let _ = SkinDescription::from_toml(&text, "x");
        }
    }
}

//! Messages as they were before the first tagged version, for bags that hold them.
//!
//! Problem: four definitions have changed, and recordings of before must still be read.
//! Method: a bag stores the type hash or the text of what it holds. Where that is one of [`UPGRADES`], its bytes are decoded as
//! they were and encoded as they are now. What the old message did not say is unknown (NaN) or has the one value that there was:
//!
//! | message | what changed | from an old message |
//! |---|---|---|
//! | `TaxelFrame` | `channels`, `unit` and `electrodes` are in `SkinGeometry`; `layout_id` refers to them | [`layout_id`](ChannelLayout::id) of its names, 0 where it has none |
//! | `SkinGeometry` | `unit`, `electrodes`, `layout_id` | `unit` as the skin's frames have it; `layout_id` 0 where it is not known |
//! | `Indentation` | `gravity` | NaN |
//! | `IndentationContact` | shape, name, pose and temperature of the tip | a sphere that touches at `position`, `depth` deep |
//!
//! `BodyContact`, `BodyContacts` and `LinkWrench` changed as well; nothing published them.
//! On the bus nothing is converted: peers with other type hashes do not match.

use crate::geometry_msgs::msg::Vector3;
use crate::{CdrError, ChannelLayout, Message, TypeSupport};

include!(concat!(env!("OUT_DIR"), "/v0.rs"));

/// One definition of before, and what became of it.
#[derive(Debug)]
pub struct Upgrade {
    /// What a recording of before says of its type.
    pub old: &'static TypeSupport,
    /// The type of today.
    pub new: &'static TypeSupport,
    convert: fn(&[u8], UnitOf<'_>) -> Result<Vec<u8>, CdrError>,
}

/// The unit of a skin's readings by the skin's name, as far as a recording tells; an old geometry does not say it.
pub type UnitOf<'a> = &'a dyn Fn(&str) -> Option<String>;

/// Every message that is converted.
pub static UPGRADES: [Upgrade; 4] = [
    Upgrade {
        old: const { &TypeSupport::new::<msg::TaxelFrame>() },
        new: const { &TypeSupport::new::<crate::msg::TaxelFrame>() },
        convert: |cdr, _| Ok(crate::msg::TaxelFrame::from(msg::TaxelFrame::from_cdr(cdr)?).to_cdr()),
    },
    Upgrade {
        old: const { &TypeSupport::new::<msg::SkinGeometry>() },
        new: const { &TypeSupport::new::<crate::msg::SkinGeometry>() },
        convert: |cdr, unit_of| {
            let old = msg::SkinGeometry::from_cdr(cdr)?;
            let unit = unit_of(&old.skin);
            Ok(old.with_unit(unit).to_cdr())
        },
    },
    Upgrade {
        old: const { &TypeSupport::new::<msg::Indentation>() },
        new: const { &TypeSupport::new::<crate::msg::Indentation>() },
        convert: |cdr, _| Ok(crate::msg::Indentation::from(msg::Indentation::from_cdr(cdr)?).to_cdr()),
    },
    Upgrade {
        old: const { &TypeSupport::new::<msg::IndentationContact>() },
        new: const { &TypeSupport::new::<crate::msg::IndentationContact>() },
        convert: |cdr, _| {
            Ok(crate::msg::IndentationContact::from(msg::IndentationContact::from_cdr(cdr)?).to_cdr())
        },
    },
];

impl Upgrade {
    /// The one for a recorded type hash.
    pub fn of_hash(type_name: &str, hash: &str) -> Option<&'static Self> {
        UPGRADES.iter().find(|upgrade| upgrade.old.name == type_name && upgrade.old.hash == hash)
    }

    /// The one for a recorded definition that is spelled as ours was, for a recording without hashes.
    pub fn of_definition(type_name: &str, text: &str) -> Option<&'static Self> {
        let same = |upgrade: &&Self| {
            upgrade.old.name == type_name && upgrade.old.definition.trim_end() == text.trim_end()
        };
        UPGRADES.iter().find(same)
    }

    /// The same message as it is encoded today.
    ///
    /// # Errors
    /// Where the bytes are not one of the old definition.
    pub fn apply(&self, cdr: &[u8], unit_of: UnitOf<'_>) -> Result<Vec<u8>, CdrError> {
        (self.convert)(cdr, unit_of)
    }
}

impl msg::TaxelFrame {
    /// Names and unit of its channels; `None` where it names none.
    pub fn layout(&self) -> Option<ChannelLayout> {
        let named = !self.channels.is_empty();
        named.then(|| ChannelLayout { unit: self.unit.clone(), channels: self.channels.clone() })
    }
}

impl From<msg::TaxelFrame> for crate::msg::TaxelFrame {
    fn from(old: msg::TaxelFrame) -> Self {
        let names = old.channels.iter().map(String::as_str);
        let layout_id = if old.channels.is_empty() { 0 } else { ChannelLayout::id_of(&old.unit, names) };
        Self {
            header: old.header,
            skin: old.skin,
            sequence: old.sequence,
            device_time_us: old.device_time_us,
            layout_id,
            values: old.values,
            flags: old.flags,
            temperature: old.temperature,
        }
    }
}

impl msg::SkinGeometry {
    /// As it is now, with the unit that its skin's frames have.
    pub fn with_unit(self, unit: Option<String>) -> crate::msg::SkinGeometry {
        let names = self.channels.iter().map(String::as_str);
        let layout_id = unit.as_deref().map_or(0, |unit| ChannelLayout::id_of(unit, names));
        crate::msg::SkinGeometry {
            header: self.header,
            skin: self.skin,
            geometry_id: self.geometry_id,
            skin_hash: self.skin_hash,
            points: self.points,
            normals: self.normals,
            areas: self.areas,
            triangles: self.triangles,
            taxels: self.taxels,
            taxel_poses: self.taxel_poses,
            layout_id,
            unit: unit.unwrap_or_default(),
            channels: self.channels,
            channel_taxels: self.channel_taxels,
            electrodes: 0,
        }
    }
}

impl From<msg::Indentation> for crate::msg::Indentation {
    fn from(old: msg::Indentation) -> Self {
        Self {
            header: old.header,
            skin: old.skin,
            session: old.session,
            press: old.press,
            location: old.location,
            repeat: old.repeat,
            phase: old.phase,
            temperature: old.temperature,
            gravity: Vector3::UNKNOWN,
            contacts: old.contacts.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<msg::IndentationContact> for crate::msg::IndentationContact {
    fn from(old: msg::IndentationContact) -> Self {
        Self::sphere(old.position, old.normal, old.force, old.force_components, old.depth, old.diameter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry_msgs::msg::Point;
    use crate::std_msgs::msg::Header;

    /// The hashes that are in the recordings: they can not change any more.
    #[test]
    fn old_definitions_have_the_hashes_of_before() {
        let hashes = UPGRADES.each_ref().map(|upgrade| (upgrade.old.name, upgrade.old.hash));
        assert_eq!(
            hashes,
            [
                (
                    "dermis_msgs/msg/TaxelFrame",
                    "RIHS01_94ae4f9777a584b314a1598d2d8153f7c71ac2974c23fec6ea4f3d7895283d18"
                ),
                (
                    "dermis_msgs/msg/SkinGeometry",
                    "RIHS01_b138bcadab25778f2c60dc6e2fee420ba8b92be2354acb5c844b30752c385e5d"
                ),
                (
                    "dermis_msgs/msg/Indentation",
                    "RIHS01_cc9c748a40bef003a66a23d0fa93fdeb69533780cf882c11949d7227f270ac8f"
                ),
                (
                    "dermis_msgs/msg/IndentationContact",
                    "RIHS01_7ff694d867f4b0a786f3d5cab3a81ed874483d1d1cc29ac431ec03b50461cb9e"
                ),
            ]
        );
        for upgrade in &UPGRADES {
            assert!(upgrade.old.name == upgrade.new.name && upgrade.old.hash != upgrade.new.hash);
            assert!(std::ptr::eq(Upgrade::of_hash(upgrade.old.name, upgrade.old.hash).unwrap(), upgrade));
            assert!(Upgrade::of_hash(upgrade.new.name, upgrade.new.hash).is_none());
            let spelled = Upgrade::of_definition(upgrade.old.name, upgrade.old.definition).unwrap();
            assert!(std::ptr::eq(spelled, upgrade));
            assert!(Upgrade::of_definition(upgrade.new.name, upgrade.new.definition).is_none());
        }
    }

    fn apply<Old: Message, New: Message>(old: &Old, unit: Option<&str>) -> New {
        let upgrade = Upgrade::of_hash(Old::TYPE_NAME, Old::TYPE_HASH).unwrap();
        let unit = |skin: &str| unit.filter(|_| skin == "pad").map(str::to_owned);
        New::from_cdr(&upgrade.apply(&old.to_cdr(), &unit).unwrap()).unwrap()
    }

    #[test]
    fn frames_refer_to_the_names_that_they_had() {
        let old = msg::TaxelFrame {
            header: Header::new(3, "link"),
            skin: "pad".into(),
            sequence: 7,
            device_time_us: 8,
            channels: vec!["p0".into(), "p1".into()],
            unit: "Pa".into(),
            values: vec![1.5, 2.5],
            flags: vec![0, 1],
            electrodes: 0,
            temperature: 300.0,
        };
        let new: crate::msg::TaxelFrame = apply(&old, None);
        assert_eq!(new.layout_id, old.layout().unwrap().id());
        let expected = crate::msg::TaxelFrame {
            header: Header::new(3, "link"),
            skin: "pad".into(),
            sequence: 7,
            device_time_us: 8,
            layout_id: new.layout_id,
            values: vec![1.5, 2.5],
            flags: vec![0, 1],
            temperature: 300.0,
        };
        assert_eq!(new, expected);
        let unnamed = msg::TaxelFrame { channels: Vec::new(), ..old.clone() };
        assert_eq!(apply::<_, crate::msg::TaxelFrame>(&unnamed, None).layout_id, 0);

        let geometry = msg::SkinGeometry { skin: "pad".into(), channels: old.channels, ..Default::default() };
        let known: crate::msg::SkinGeometry = apply(&geometry, Some("Pa"));
        assert_eq!((known.layout_id, known.unit.as_str()), (new.layout_id, "Pa"));
        let unknown: crate::msg::SkinGeometry = apply(&geometry, None);
        assert_eq!(
            (unknown.layout_id, unknown.unit.as_str(), &unknown.channels),
            (0, "", &geometry.channels)
        );
    }

    #[test]
    fn presses_were_those_of_spheres() {
        let contact = msg::IndentationContact {
            position: Point { x: 0.1, y: 0.2, z: 0.0 },
            normal: Vector3 { x: 0.0, y: 0.0, z: 1.0 },
            force: Vector3 { x: 0.0, y: 0.0, z: -2.0 },
            force_components: 2,
            depth: 0.001,
            diameter: 0.004,
        };
        let old =
            msg::Indentation { skin: "pad".into(), phase: 3, contacts: vec![contact], ..Default::default() };
        let new: crate::msg::Indentation = apply(&old, None);
        assert!(new.gravity.x.is_nan() && new.phase == 3);
        let tip = &new.contacts[0];
        assert_eq!(
            (tip.tip, tip.diameter, tip.depth),
            (crate::msg::IndentationContact::TIP_SPHERE, 0.004, 0.001)
        );
        assert_eq!((tip.tip_pose.position.x, tip.tip_pose.position.z), (0.1, -0.001));
        assert_eq!((tip.tip_pose.orientation.w, tip.force.z), (1.0, -2.0));
        assert!(tip.temperature.is_nan());
    }

    #[test]
    fn what_is_no_old_message_is_refused() {
        let upgrade = Upgrade::of_hash(msg::TaxelFrame::TYPE_NAME, msg::TaxelFrame::TYPE_HASH).unwrap();
        let error = upgrade.apply(&[0, 1, 0, 0, 9], &|_| None).unwrap_err();
        assert!(error.to_string().starts_with("not a dermis_msgs/msg/TaxelFrame"), "{error}");
    }
}

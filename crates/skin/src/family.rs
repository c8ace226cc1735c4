//! What sensor families add to skin descriptions: shapes of their own, and elements and channels that follow from a few
//! numbers instead of being listed.
//!
//! A skin file names its family. Reading the file asks that family, where the program knows it, to fill in what the file
//! leaves to it. Programs [register](register) their families when they start.

use std::collections::BTreeMap;
use std::sync::{PoisonError, RwLock};

use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::description::{SkinDescription, SurfaceSpec};
use crate::mesh::TriangleMesh;
use crate::rated::Rated;

/// A field of a skin description that cannot be, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldFault {
    /// Path of the field, e.g. `surface.radius`.
    pub field: String,
    /// What is wrong with it, and what would be right.
    pub reason: String,
}

impl FieldFault {
    /// What is wrong with `field`.
    pub fn new(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { field: field.into(), reason: reason.into() }
    }
}

/// What a sensor family fills into the descriptions of its skins.
pub trait Family: Send + Sync {
    /// What skin descriptions name in `sensor`.
    fn name(&self) -> &'static str;

    /// Fills in what the file leaves to the family: [the mesh](SkinDescription::set_shape) of a shape of its own, taxels,
    /// [channels](SkinDescription::set_channels). What the file lists already stays: a description that was completed and written
    /// comes here again when it is read.
    ///
    /// # Errors
    ///
    /// [`FieldFault`] names what cannot be.
    fn complete(&self, skin: &mut SkinDescription) -> Result<(), FieldFault> {
        let _ = skin;
        Ok(())
    }

    /// What usually presses such a skin, where its file does not say.
    fn rated(&self, skin: &SkinDescription) -> Rated {
        let _ = skin;
        Rated::default()
    }
}

static FAMILIES: RwLock<BTreeMap<&'static str, &'static dyn Family>> = RwLock::new(BTreeMap::new());

/// Lets this family complete every skin description that is read from now on. A family of the same name is replaced.
pub fn register(family: &'static dyn Family) {
    FAMILIES.write().unwrap_or_else(PoisonError::into_inner).insert(family.name(), family);
}

/// The registered family of that name.
pub(crate) fn registered(name: &str) -> Option<&'static dyn Family> {
    FAMILIES.read().unwrap_or_else(PoisonError::into_inner).get(name).copied()
}

/// A shape that only its sensor family knows: its name and parameters as the file says them, and the mesh that the family makes
/// of them.
#[derive(Debug, Clone, PartialEq)]
pub struct FamilyShape {
    /// Name of the shape.
    pub name: String,
    /// All other keys of the table `surface`.
    pub parameters: toml::Table,
    pub(crate) mesh: TriangleMesh,
}

impl FamilyShape {
    /// The parameters, as the family knows them.
    ///
    /// # Errors
    ///
    /// [`FieldFault`] with the field `surface.…` that is missing, unknown or of another type.
    pub fn parameters_as<T: DeserializeOwned>(&self) -> Result<T, FieldFault> {
        dermis_io::toml::of_table(self.parameters.clone()).map_err(|fault| {
            let (field, reason) = fault.into_field_of("surface");
            FieldFault::new(field, reason)
        })
    }
}

/// Shapes that every family may use.
const SHAPES: [&str; 4] = ["rectangle", "dome", "panel", "mesh"];

/// Writes the table `surface`.
pub(crate) fn serialize_surface<S: Serializer>(spec: &SurfaceSpec, to: S) -> Result<S::Ok, S::Error> {
    match spec {
        SurfaceSpec::Family(shape) => {
            let mut table = toml::Table::new();
            table.insert("type".to_owned(), toml::Value::String(shape.name.clone()));
            table.extend(shape.parameters.clone());
            table.serialize(to)
        }
        spec => spec.serialize(to),
    }
}

/// Reads the table `surface`: one of the shapes that every family may use, or one whose name only the family knows.
pub(crate) fn deserialize_surface<'de, D: Deserializer<'de>>(from: D) -> Result<SurfaceSpec, D::Error> {
    let mut table = toml::Table::deserialize(from)?;
    let name = match table.get("type") {
        Some(toml::Value::String(name)) => name.clone(),
        Some(_) => return Err(D::Error::custom("`type` must be a text")),
        None => return Err(D::Error::custom("missing field `type`")),
    };
    if SHAPES.contains(&name.as_str()) {
        return SurfaceSpec::deserialize(toml::Value::Table(table))
            .map_err(|error| D::Error::custom(error.message().trim().replace('\n', " ")));
    }
    table.remove("type");
    Ok(SurfaceSpec::Family(FamilyShape { name, parameters: table, mesh: TriangleMesh::default() }))
}

/// Has the family complete `skin`.
///
/// # Errors
///
/// What the family says; a shape that nobody knows.
pub(crate) fn complete(skin: &mut SkinDescription) -> Result<(), FieldFault> {
    if let Some(family) = registered(&skin.sensor) {
        family.complete(skin)?;
    }
    match &skin.surface {
        SurfaceSpec::Family(shape) if shape.mesh.is_empty() => Err(FieldFault::new(
            "surface.type",
            format!(
                "is \"{}\", a shape that neither this program nor its sensor family `{}` knows; every family knows {}",
                shape.name,
                skin.sensor,
                SHAPES.join(", ")
            ),
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Channel, Taxel};
    use nalgebra::Point3;

    /// A square whose four elements and eight channels follow from its width.
    struct Squares;

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Square {
        width: f64,
    }

    impl Family for Squares {
        fn name(&self) -> &'static str {
            "squares"
        }

        fn complete(&self, skin: &mut SkinDescription) -> Result<(), FieldFault> {
            let SurfaceSpec::Family(shape) = &skin.surface else { return Ok(()) };
            if shape.name != "square" {
                return Ok(());
            }
            let Square { width } = shape.parameters_as()?;
            if !(width > 0.0 && width < 1.0) {
                return Err(FieldFault::new("surface.width", format!("is {width} m and must be 0 to 1")));
            }
            let corner = |i: u32| Point3::new(f64::from(i % 2) * width, f64::from(i / 2) * width, 0.0);
            let mesh = TriangleMesh::from_triangles((0..4).map(corner).collect(), &[[0, 1, 3], [0, 3, 2]], 1)
                .map_err(|reason| FieldFault::new("surface", reason))?;
            skin.set_shape(mesh);
            if skin.taxels.is_empty() {
                skin.taxels = (0..4)
                    .map(|i| Taxel {
                        name: format!("t{i}"),
                        position: corner(i).into(),
                        normal: [0.0, 0.0, 1.0],
                        axis: None,
                    })
                    .collect();
            }
            if skin.channels().is_empty() {
                let channel = |i: usize| Channel {
                    name: format!("v{i}"),
                    taxel: format!("t{}", i / 2),
                    range: None,
                    noise: None,
                };
                skin.set_channels((0..8).map(channel).collect());
            }
            Ok(())
        }
    }

    const FILE: &str = r#"
schema = "dermis-skin/1"
name = "tile"
sensor = "squares"
frame_id = "tile_link"
unit = "V"
rate = 100.0
noise = 0.001
surface = { type = "square", width = 0.1 }
"#;

    fn read(text: &str) -> Result<SkinDescription, String> {
        register(&Squares);
        SkinDescription::from_toml(text, "tile.toml").map_err(|e| e.to_string())
    }

    #[test]
    fn a_family_fills_in_what_follows() {
        let skin = read(FILE).unwrap();
        assert_eq!((skin.taxels.len(), skin.channels().len(), skin.channel_noise()[7]), (4, 8, 0.001));
        let surface = skin.surface();
        approx::assert_relative_eq!(surface.areas.iter().sum::<f64>(), 0.01, max_relative = 1e-9);
        let (on, normal) = surface.project(&Point3::new(0.05, 0.02, 0.3));
        assert!((on - Point3::new(0.05, 0.02, 0.0)).norm() < 1e-9 && normal.z > 0.999);
        let written = toml::to_string(&skin).unwrap();
        let again = SkinDescription::from_toml(&written, "written").unwrap();
        assert_eq!((again.hash(), &again), (skin.hash(), &skin));
    }

    #[test]
    fn the_shape_is_part_of_the_type() {
        let wider = read(&FILE.replace("width = 0.1", "width = 0.2")).unwrap();
        assert_ne!(wider.hash(), read(FILE).unwrap().hash());
    }

    #[test]
    fn refusals_name_the_field() {
        let refused = |from: &str, to: &str| read(&FILE.replace(from, to)).unwrap_err();
        insta::assert_snapshot!(refused("width = 0.1", "width = -1.0"), @"skin file tile.toml: field `surface.width`: is -1 m and must be 0 to 1");
        insta::assert_snapshot!(refused("width = 0.1", "wide = 0.1"), @"skin file tile.toml: field `surface.wide`: unknown field `wide`, expected `width`");
        insta::assert_snapshot!(refused("\"square\"", "\"circle\""), @r#"skin file tile.toml: field `surface.type`: is "circle", a shape that neither this program nor its sensor family `squares` knows; every family knows rectangle, dome, panel, mesh"#);
        insta::assert_snapshot!(refused("type = \"square\", ", ""), @"skin file tile.toml: field `surface`: missing field `type`");
        insta::assert_snapshot!(refused("type = \"square\", width = 0.1", "type = \"dome\", radius = 0.1"), @"skin file tile.toml: field `surface`: missing field `cylinder`");
    }
}

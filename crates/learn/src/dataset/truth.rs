//! What was true of a skin at one instant.

use dermis_model::{Tip, TipShape};
use dermis_skin::ForceComponents;
use nalgebra::{Point3, Vector3};

/// One true contact at one instant, in the frame of the skin's link. What is unknown is NaN.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthContact {
    /// \[m\] first point of contact on the undeformed surface.
    pub position: Point3<f64>,
    /// Unit, out of the skin.
    pub normal: Vector3<f64>,
    /// \[N\] exerted on the skin.
    pub force: Vector3<f64>,
    /// Which components of `force` are known.
    pub components: ForceComponents,
    /// \[m\] diameter of the tip.
    pub diameter: f64,
    /// Whether the tip is the flat end of a round rod; whatever else it is, it is taken for a sphere.
    pub flat: bool,
}

impl TruthContact {
    /// The tip that a model is evaluated for, standing straight on the surface.
    #[must_use]
    pub fn tip(&self) -> Tip {
        if self.flat {
            Tip::standing(TipShape::FlatPunch { diameter: self.diameter }, &self.normal)
        } else {
            Tip::sphere(self.diameter)
        }
    }

    /// \[N\] pressing force, positive when pushed in; `None` where unknown.
    #[must_use]
    pub fn normal_force(&self) -> Option<f64> {
        // A component across the normal may be unknown, and NaN · 0 is NaN.
        let along = self.force.iter().zip(&self.normal).filter(|(_, n)| **n != 0.0);
        let force = -along.map(|(f, n)| f * n).sum::<f64>();
        (self.components != ForceComponents::None && force.is_finite()).then_some(force)
    }
}

/// What was true at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Counts presses within the session.
    pub press: u64,
    /// Identity of the contact location.
    pub location: u32,
    /// Whether the testbed stood by, away from the skin: a stretch in which the zero can be taken.
    pub idle: bool,
    /// All contacts; empty means that the skin was untouched.
    pub contacts: Vec<TruthContact>,
}

impl Truth {
    /// Names of the quantities that [`value`](Self::value) knows.
    pub const TARGETS: [&'static str; 8] = [
        "position.x",
        "position.y",
        "position.z",
        "force.x",
        "force.y",
        "force.z",
        "force.normal",
        "contact",
    ];

    /// Whether something touches the skin.
    #[must_use]
    pub fn touched(&self) -> bool {
        !self.contacts.is_empty()
    }

    /// The only contact; `None` where there is none or more than one.
    #[must_use]
    pub fn single(&self) -> Option<&TruthContact> {
        match self.contacts.as_slice() {
            [contact] => Some(contact),
            _ => None,
        }
    }

    /// One of [`TARGETS`](Self::TARGETS) in SI units, `None` where it is unknown or has no meaning: a position of
    /// an untouched skin, or anything but `contact` of several contacts. Untouched means no force.
    #[must_use]
    pub fn value(&self, target: &str) -> Option<f64> {
        if target == "contact" {
            return Some(f64::from(u8::from(self.touched())));
        }
        if !self.touched() {
            return target.starts_with("force.").then_some(0.0);
        }
        let contact = self.single()?;
        let full = |v: f64| (contact.components == ForceComponents::Full).then_some(v);
        let value = match target {
            "position.x" => Some(contact.position.x),
            "position.y" => Some(contact.position.y),
            "position.z" => Some(contact.position.z),
            "force.x" => full(contact.force.x),
            "force.y" => full(contact.force.y),
            "force.z" => full(contact.force.z),
            "force.normal" => contact.normal_force(),
            _ => None,
        };
        value.filter(|v| v.is_finite())
    }
}

//! What rules say, after a file was checked.
//!
//! Forces are in newtons, lengths in metres, pressures in pascals and times in seconds of [`Duration`]. Only the file
//! writes pressures in N/cm², as ISO/TS 15066 does.

use std::fmt;
use std::time::Duration;

use serde::Deserialize;

/// Pascals in one N/cm².
pub const PASCALS_PER_N_PER_CM2: f64 = 1e4;

/// A set of rules and what they refer to.
#[derive(Debug, Clone, PartialEq)]
pub struct Rules {
    /// Name of the set: the node's name where it is given none.
    pub name: String,
    /// How rules start.
    pub start: Start,
    /// What is sent when the node ends.
    pub at_end: AtEnd,
    /// Messages that are listened to.
    pub inputs: Vec<Input>,
    /// Actions, in the order of the file's names.
    pub actions: Vec<Action>,
    /// Rules, in the order of the file.
    pub rules: Vec<Rule>,
}

/// How rules start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// Latching rules act from the start, until they are released once: a crash of the node releases nothing.
    #[default]
    Stopped,
    /// Rules act as long as a sense is missing, and latch from then on when they act.
    Clear,
}

/// What is sent when the node ends in an orderly way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AtEnd {
    /// Every action that publishes acts once more: nobody guards the robot from now on.
    #[default]
    Act,
    /// Nothing.
    Silent,
}

/// A topic that is listened to.
#[derive(Debug, Clone, PartialEq)]
pub struct Input {
    /// Name in the file.
    pub name: String,
    /// What comes on it.
    pub kind: InputKind,
    /// Topic.
    pub topic: String,
    /// Longest time without a new message; longer is [`Loss::Late`].
    pub timeout: Duration,
    /// Largest age of a message when it arrives, from its stamp on; older is [`Loss::Late`]. `None`: not inspected.
    pub max_age: Option<Duration>,
}

/// What comes on a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum InputKind {
    /// `dermis_msgs/msg/BodyContacts`.
    Body,
    /// `dermis_msgs/msg/ContactArray` of one skin.
    Skin {
        /// Its name; a message of another skin is a fault. `None`: any.
        skin: Option<String>,
        /// Link that it is on, where known.
        link: Option<String>,
    },
}

/// A part of the robot: contacts on any of the links or of the skins. Everything where both are empty.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Region {
    /// Links of the robot.
    pub links: Vec<String>,
    /// Names of skins.
    pub skins: Vec<String>,
}

impl Region {
    /// Whether it is the whole robot.
    #[must_use]
    pub fn is_everything(&self) -> bool {
        self.links.is_empty() && self.skins.is_empty()
    }

    /// Whether a link is in it.
    #[must_use]
    pub fn has_link(&self, link: &str) -> bool {
        self.is_everything() || self.links.iter().any(|l| l == link)
    }

    /// Whether a skin is in it by its name.
    #[must_use]
    pub fn has_skin(&self, skin: &str) -> bool {
        self.is_everything() || self.skins.iter().any(|s| s == skin)
    }
}

/// A threshold with hysteresis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Threshold {
    /// A value above this acts.
    pub above: f64,
    /// A value above this keeps what acts acting.
    pub release: f64,
}

/// Limits of one body region of a person, as ISO/TS 15066 writes them.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactLimits {
    /// Name in the file: the body region.
    pub name: String,
    /// Of a contact that lasts.
    pub quasi_static: LimitPair,
    /// Of a contact that has just begun; the quasi-static ones where the file gives none.
    pub transient: LimitPair,
    /// How long a contact counts as transient.
    pub time_to_quasi_static: Duration,
    /// Share of the quasi-static limits below which the condition no longer holds.
    pub release_ratio: f64,
}

/// Largest force and pressure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimitPair {
    /// \[N\] of one contact; `None`: not limited.
    pub force: Option<f64>,
    /// \[Pa\] of one contact; `None`: not limited.
    pub pressure: Option<f64>,
}

/// How much of a contact slides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Slip {
    /// A part of it, or all.
    Incipient,
    /// All of it.
    Gross,
}

/// What explains a contact, as the fusion says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// Another link of the robot.
    #[serde(rename = "self")]
    SelfContact,
    /// A support or a tool that the configuration of the fusion names.
    Expected,
}

/// A way in which the robot does not feel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Loss {
    /// The input has been silent for longer than its timeout, or its message was too old, or the same as before.
    Late,
    /// Nothing has come from the skin, or nobody speaks for it.
    Missing,
    /// The skin has had no frame for longer than its own timeout.
    Stale,
    /// The skin is not tared, or has no model.
    Uncalibrated,
    /// The readings of the skin cannot be trusted.
    Fault,
    /// Channels of the skin are missing.
    Degraded,
    /// There is a contact, and the message does not say what the rule asks: force, diameter, velocity, slip.
    Unmeasured,
}

impl Loss {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Late,
        Self::Missing,
        Self::Stale,
        Self::Uncalibrated,
        Self::Fault,
        Self::Degraded,
        Self::Unmeasured,
    ];
    /// Those that count as touched where a rule says nothing: all but a degraded skin, which still reports contacts.
    pub const USUAL: [Self; 6] =
        [Self::Late, Self::Missing, Self::Stale, Self::Uncalibrated, Self::Fault, Self::Unmeasured];

    /// As the file names it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Late => "late",
            Self::Missing => "missing",
            Self::Stale => "stale",
            Self::Uncalibrated => "uncalibrated",
            Self::Fault => "fault",
            Self::Degraded => "degraded",
            Self::Unmeasured => "unmeasured",
        }
    }
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// One rule.
#[derive(Debug, Clone, PartialEq)]
pub struct Rule {
    /// Name in the file.
    pub name: String,
    /// Where it feels.
    pub region: Region,
    /// Name of the region in the file; `None`: everything.
    pub region_name: Option<String>,
    /// Indices of the inputs that it listens to; at least one.
    pub inputs: Vec<usize>,
    /// \[N\] of one contact.
    pub force: Option<Threshold>,
    /// \[Pa\] of one contact: its largest, by [`Rule::peak_over_mean`].
    pub pressure: Option<Threshold>,
    /// \[m/s\] of a contact along the surface.
    pub speed: Option<Threshold>,
    /// Slip of at least this kind.
    pub slip: Option<Slip>,
    /// Limits of a body region.
    pub limits: Option<ContactLimits>,
    /// Losses of sense that count as touched.
    pub counts_as_touched: Vec<Loss>,
    /// Causes of contacts that it leaves out.
    pub ignore: Vec<Cause>,
    /// Contacts with less confidence are left out.
    pub least_confidence: f64,
    /// Standard deviations that are added to each force before it is compared.
    pub sigmas: f64,
    /// Largest pressure of a contact over its mean. 1.5 is that of a sphere on a flat surface (Hertz; K. L. Johnson,
    /// Contact Mechanics, 1985, section 4.2).
    pub peak_over_mean: f64,
    /// How long a condition has to hold before the rule acts.
    pub hold: Duration,
    /// How long no condition may hold before the rule can be, or is, released.
    pub quiet: Duration,
    /// Whether it acts until it is released explicitly.
    pub latch: bool,
    /// Indices of its actions; at least one.
    pub actions: Vec<usize>,
}

impl Rule {
    /// Whether a loss of sense counts as touched.
    #[must_use]
    pub fn counts(&self, loss: Loss) -> bool {
        self.counts_as_touched.contains(&loss)
    }
}

/// Something to do.
#[derive(Debug, Clone, PartialEq)]
pub struct Action {
    /// Name in the file.
    pub name: String,
    /// What.
    pub kind: ActionKind,
    /// Period at which a message is sent again while it acts, and a call is made again that had no success.
    pub repeat: Duration,
    /// Period at which it says that it does not act; `None`: only when it stops acting.
    pub heartbeat: Option<Duration>,
}

/// What is done.
#[derive(Debug, Clone, PartialEq)]
pub enum ActionKind {
    /// `std_msgs/msg/Bool`: `value` while it acts, the opposite otherwise.
    Bool {
        /// Topic.
        topic: String,
        /// What is sent while it acts.
        value: bool,
    },
    /// `std_msgs/msg/Empty` while it acts.
    Empty {
        /// Topic.
        topic: String,
    },
    /// A zero `geometry_msgs/msg/Twist`, or `TwistStamped`, while it acts.
    Twist {
        /// Topic.
        topic: String,
        /// Coordinate frame of a `TwistStamped`; `None`: a `Twist`.
        stamped: Option<String>,
    },
    /// `std_msgs/msg/Float64`: the smallest scale of all actions on this topic that act, 1 where none does.
    SpeedScale {
        /// Topic.
        topic: String,
        /// 0..1.
        scale: f64,
    },
    /// Calls a `std_srvs/srv/Trigger` until it answers with success.
    Trigger {
        /// Service.
        service: String,
    },
    /// Cancels all goals of an action, by its service `_action/cancel_goal`, again and again while it acts.
    Cancel {
        /// Action.
        action: String,
    },
}

impl ActionKind {
    /// As the file names it.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Bool { .. } => "bool",
            Self::Empty { .. } => "empty",
            Self::Twist { .. } => "twist",
            Self::SpeedScale { .. } => "speed_scale",
            Self::Trigger { .. } => "trigger",
            Self::Cancel { .. } => "cancel",
        }
    }

    /// Topic, service or action that it goes to.
    #[must_use]
    pub fn target(&self) -> &str {
        match self {
            Self::Bool { topic, .. }
            | Self::Empty { topic }
            | Self::Twist { topic, .. }
            | Self::SpeedScale { topic, .. } => topic,
            Self::Trigger { service } => service,
            Self::Cancel { action } => action,
        }
    }

    /// Whether both are speed scales on one topic, of which the smallest counts.
    #[must_use]
    pub fn scales_with(&self, other: &Self) -> bool {
        let scales = |kind: &Self| matches!(kind, Self::SpeedScale { .. });
        scales(self) && scales(other) && self.target() == other.target()
    }

    /// Whether it is a call, which is answered, and no message.
    #[must_use]
    pub const fn is_call(&self) -> bool {
        matches!(self, Self::Trigger { .. } | Self::Cancel { .. })
    }
}

//! Causes that skins of every kind can have: of cables, converters, drivers, tips and mounts. Sizes are those of a layer.

use crate::cause::{CauseInfo, Cell};

pub(crate) const DRAGGING_TIP: CauseInfo = CauseInfo::new(
    "dragging-tip",
    "a tip that slides drags the surface along; friction grows less than the load; the rig's force cell has one axis and does not see it",
    "Schallamach; F_t = μ F (F / 1 N)^(-1/9), smoothed at low speed",
    ("friction", "1", 1.2),
    false,
    true,
)
.cell(Cell::OtherLaw);

pub(crate) const SOFTENING: CauseInfo = CauseInfo::new(
    "softening",
    "where it was loaded before the material answers less below the load that it knows",
    "Ogden and Roxburgh 1999",
    ("loss", "1", 0.7),
    false,
    true,
)
.cell(Cell::OtherLaw);

pub(crate) const INNER_FRICTION: CauseInfo = CauseInfo::new(
    "inner-friction",
    "loading reads less than unloading, whatever the speed",
    "Bouc 1967, Wen 1976; amplitude in proportion to the load",
    ("half-width", "1", 0.5),
    false,
    true,
)
.cell(Cell::OtherLaw);

pub(crate) const SOFT_CEILING: CauseInfo = CauseInfo::new(
    "soft-ceiling",
    "readings bend over towards a ceiling",
    "hyperbolic tangent above 60 % of the ceiling",
    ("depth", "1", 0.95),
    false,
    true,
)
.cell(Cell::OtherLaw);

pub(crate) const LATE_STAMPS: CauseInfo = CauseInfo::new(
    "late-stamps",
    "readings are stamped some time after they were taken",
    "buffers of a driver",
    ("time", "s", 0.06),
    false,
    true,
);

pub(crate) const CROSSTALK: CauseInfo = CauseInfo::new(
    "crosstalk",
    "neighbours on the bus read a part of each other",
    "shared reference",
    ("share", "1", 0.5),
    false,
    true,
);

pub(crate) const MAINS_INTERFERENCE: CauseInfo = CauseInfo::new(
    "mains-interference",
    "interference of the mains, aliased by the sampling, other on each channel",
    "49.93 Hz at 100 frames a second",
    ("amplitude", "Pa", 4000.0),
    false,
    true,
);

pub(crate) const WARMING_UP: CauseInfo = CauseInfo::new(
    "warming-up",
    "gain settles for minutes after power-on",
    "self-heating of the electronics, supply of bridges",
    ("start", "1", 0.9),
    true,
    false,
);

pub(crate) const CABLE_TUG: CauseInfo = CauseInfo::new(
    "cable-tug",
    "on some presses a cable pulls at two channels, and they read a constant more",
    "strain relief missing",
    ("deviation", "Pa", 9000.0),
    true,
    false,
)
.cell(Cell::DoesNotRepeat);

pub(crate) const WEARING: CauseInfo = CauseInfo::new(
    "wearing",
    "readings fade with the number of presses near a channel",
    "fatigue, exp(-n / n0)",
    ("loss", "1", 0.9),
    false,
    true,
);

pub(crate) const STALE_FRAMES: CauseInfo = CauseInfo::new(
    "stale-frames",
    "bursts of frames repeat the last one before them",
    "lost transfers that a driver hides",
    ("share", "1", 0.9),
    false,
    false,
)
.cell(Cell::DoesNotRepeat);

pub(crate) const UNEVEN_STEPS: CauseInfo = CauseInfo::new(
    "uneven-steps",
    "the converter's error goes up and down with the reading",
    "integral non-linearity of converters in stages",
    ("depth", "1", 0.9),
    false,
    false,
)
.cell(Cell::DoesNotRepeat);

pub(crate) const SAGGING_SUPPLY: CauseInfo = CauseInfo::new(
    "sagging-supply",
    "the more all channels read, the less is left for each: their common supply gives way",
    "series resistance of the supply",
    ("share", "1", 0.9),
    false,
    false,
);

pub(crate) const BUMPED_MOUNT: CauseInfo = CauseInfo::new(
    "bumped-mount",
    "from one moment on the skin lies beside its place",
    "a loose screw",
    ("shift", "m", 0.004),
    false,
    false,
)
.cell(Cell::DoesNotRepeat);

pub(crate) const PREISACH_FRICTION: CauseInfo = CauseInfo::new(
    "preisach-friction",
    "loading reads less than unloading, whatever the speed, by relays that switch up at one level and down at a lower one",
    "Preisach 1935, Mayergoyz 1986; narrow relays most often",
    ("share", "1", 0.9),
    false,
    true,
)
.cell(Cell::OtherLaw);

pub(crate) const SLIPPING_ELEMENTS: CauseInfo = CauseInfo::new(
    "slipping-elements",
    "loading reads less than unloading, whatever the speed, by springs that slip one after another",
    "Maxwell slip; Iwan 1966",
    ("half-width", "1", 0.5),
    false,
    true,
)
.cell(Cell::OtherLaw);

pub(crate) const STANDARD_SOLID: CauseInfo = CauseInfo::new(
    "standard-solid",
    "a reading that is held goes towards another one with one time constant, from 0.5 to 5 s",
    "Zener's standard linear solid",
    ("share", "1", 0.7),
    false,
    true,
);

pub(crate) const WEARING_LOGARITHMIC: CauseInfo = CauseInfo::new(
    "wearing-logarithmic",
    "readings fade with the logarithm of the number of presses near a channel",
    "fatigue after Basquin",
    ("loss", "1", 0.9),
    false,
    true,
)
.cell(Cell::OtherLaw);

pub(crate) const BENDING_OVER: CauseInfo = CauseInfo::new(
    "bending-over",
    "readings bend over towards a ceiling, from the smallest on",
    "algebraic saturation, v / (1 + |v / c|³)^(1/3)",
    ("depth", "1", 0.95),
    false,
    true,
)
.cell(Cell::OtherLaw);

pub(crate) const SOFT_SPOT: CauseInfo = CauseInfo::new(
    "soft-spot",
    "around one place the skin gives way more and reads more, the more the harder it is pressed",
    "local damage or cure",
    ("rise", "1", 3.0),
    false,
    false,
);

pub(crate) const PERMANENT_SET: CauseInfo = CauseInfo::new(
    "permanent-set",
    "what a channel has been pressed to leaves a share of it behind for good",
    "compression set of rubber, plastic strain",
    ("share", "1", 0.4),
    false,
    false,
);

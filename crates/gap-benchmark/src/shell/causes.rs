//! What can make a shell with strain gauges differ from its design.

use crate::cause::{CauseInfo, Cell};
use crate::common;

/// All of them.
pub(crate) const CAUSES: &[CauseInfo] = &[
    CauseInfo::new(
        "stiffer-wall",
        "the wall's material is stiffer or softer than its data sheet says",
        "print batch, moisture",
        ("relative-change", "1", 0.5),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "uneven-wall",
        "the wall is thicker here and thinner there, in waves of some centimetres",
        "printing tolerances; sum of random cosines",
        ("deviation", "1", 0.4),
        false,
        true,
    ),
    CauseInfo::new(
        "printed-direction",
        "the material is softer around the limb than along it; Huber's shear modulus follows",
        "layers of a print",
        ("loss", "1", 0.85),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "yielding-clamp",
        "both ends are held by springs instead of a rigid clamp",
        "screws and brackets; stiffness per mesh node falls by decades",
        ("decades", "1", 7.0),
        false,
        true,
    ),
    CauseInfo::new(
        "stretching",
        "a shell that is bent far carries more by stretching: strain grows as F (1 + F / 10 N)^-p",
        "membrane action of thin plates, as a power law of the force",
        ("power", "1", 0.7),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "gauge-factors",
        "every gauge has a gain of its own",
        "glue and carrier",
        ("deviation", "1", 0.6),
        false,
        true,
    ),
    CauseInfo::new(
        "displaced-gauges",
        "gauges lie elsewhere than drawn",
        "hand-glued",
        ("deviation", "m", 0.006),
        false,
        true,
    ),
    CauseInfo::new(
        "turned-gauges",
        "gauges are glued askew",
        "hand-glued",
        ("deviation", "rad", 0.7),
        false,
        true,
    ),
    CauseInfo::new(
        "strain-across",
        "gauges measure a share of the strain across",
        "transverse sensitivity of foils",
        ("share", "1", 0.6),
        true,
        true,
    ),
    CauseInfo::new(
        "leads-off",
        "one gauge's lead makes poor contact and it reads a part only",
        "broken solder joint",
        ("loss", "1", 1.0),
        false,
        true,
    ),
    CauseInfo::new(
        "askew-tip",
        "the indenter stands askew in a fixed direction; the rig's cell measures along the normal",
        "mounting of the rig",
        ("angle", "rad", 0.7),
        false,
        true,
    ),
    common::DRAGGING_TIP,
    CauseInfo::new(
        "flowing-plastic",
        "under a force that stays strain goes on growing, over a continuous spectrum of times",
        "power-law creep spectrum, 0.03 to 100 s",
        ("share", "1", 0.8),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "warm-zero",
        "zeros move with the temperature, each gauge's differently and a little curved",
        "apparent strain",
        ("coefficient", "1/K", 6e-5),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "walking-zero",
        "zeros follow a random walk",
        "glue and moisture; Brownian motion",
        ("deviation-after-100-s", "1", 3e-4),
        false,
        true,
    ),
    common::SOFT_CEILING,
    common::LATE_STAMPS,
    // What a library of known effects will hardly hold.
    CauseInfo { size: ("share", "1", 0.8), ..common::CROSSTALK },
    CauseInfo { size: ("amplitude", "1", 5e-4), ..common::MAINS_INTERFERENCE },
    common::WARMING_UP,
    CauseInfo { size: ("deviation", "1", 1e-3), ..common::CABLE_TUG },
    common::WEARING,
    common::STALE_FRAMES,
    CauseInfo::new(
        "nonlinear-characteristic",
        "every gauge has a quadratic share of its own",
        "non-linearity of the bridge",
        ("deviation", "1", 4e3),
        false,
        false,
    ),
    CauseInfo::new(
        "rubbing-joint",
        "a joint in the wall rubs: loading reads less than unloading, whatever the speed",
        "Bouc 1967, Wen 1976; amplitude in proportion to the load",
        ("half-width", "1", 0.5),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "broken-beam",
        "the wall is thin in one place, as after a crack",
        "overload",
        ("loss", "1", 0.8),
        false,
        false,
    ),
    common::UNEVEN_STEPS,
    common::SAGGING_SUPPLY,
    CauseInfo { size: ("shift", "m", 0.02), ..common::BUMPED_MOUNT },
    common::PREISACH_FRICTION,
    common::SLIPPING_ELEMENTS,
    common::STANDARD_SOLID,
    common::WEARING_LOGARITHMIC,
    common::BENDING_OVER,
    common::SOFT_SPOT,
    common::PERMANENT_SET,
    // Numbers of the description that the device was not built with.
    CauseInfo::new(
        "built-wall",
        "the wall was printed thicker or thinner than its description says, everywhere alike",
        "another nozzle or slice",
        ("relative-change", "1", 0.4),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "built-poisson",
        "the wall's material is more compressible than its description says",
        "porous print",
        ("relative-loss", "1", 0.8),
        false,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "built-gauge",
        "gauges are longer or shorter than their description says",
        "another type of foil",
        ("relative-change", "1", 0.9),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "built-patch",
        "a touch presses over a wider or narrower patch than the description says",
        "another tip pad",
        ("relative-change", "1", 0.9),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
];

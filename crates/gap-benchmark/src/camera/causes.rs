//! What can make a camera inside an elastomer differ from its design.

use crate::cause::{CauseInfo, Cell};
use crate::{common, loads};

/// All of them.
pub(crate) const CAUSES: &[CauseInfo] = &[
    // Light.
    CauseInfo::new(
        "weak-lamp",
        "one lamp is darker than the others: what it lights is",
        "a worn or badly soldered LED",
        ("loss", "1", 1.0),
        false,
        true,
    ),
    CauseInfo::new(
        "fading-lamps",
        "all lamps fade with the logarithm of the time that they are on",
        "ageing of LEDs",
        ("loss-after-an-hour", "1", 0.95),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "warm-lamps",
        "warm lamps are darker, exponentially in the temperature",
        "thermal droop of LEDs",
        ("coefficient", "1/K", 0.15),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "white-balance",
        "each colour has a gain of its own",
        "white balance of another camera",
        ("deviation", "1", 1.2),
        false,
        true,
    ),
    CauseInfo::new(
        "automatic-balance",
        "gains of the colours follow the picture: a colour that grows in the mean is turned down",
        "grey-world white balance (Buchsbaum 1980)",
        ("share", "1", 1.0),
        false,
        false,
    ),
    CauseInfo::new(
        "automatic-exposure",
        "the exposure follows the picture's mean brightness, a third of a second late",
        "control of cameras",
        ("share", "1", 1.0),
        false,
        false,
    ),
    CauseInfo::new(
        "beating-lamps",
        "lamps that are driven by pulses beat with the rows of the picture",
        "pulse-width modulation against the frame rate",
        ("depth", "1", 0.6),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "scratched-inside",
        "around one place the reflecting inside is scratched, and opens where it is pressed: it turns dark there",
        "wear of a reflecting coat",
        ("loss", "1", 0.95),
        false,
        false,
    ),
    // Lens and picture.
    CauseInfo::new(
        "out-of-focus",
        "the lens is out of focus: every point is a disc",
        "geometric blur, uniform disc",
        ("radius", "px", 25.0),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "vignetting",
        "the picture is darker towards its rim, where touches show less",
        "cos⁴ law",
        ("power", "1", 4.0),
        false,
        false,
    ),
    CauseInfo::new(
        "stained-lens",
        "drops on the lens take contrast from some of the picture",
        "oil that leaves the elastomer",
        ("loss", "1", 0.98),
        false,
        false,
    ),
    CauseInfo::new(
        "askew-camera",
        "the camera sits and looks askew: the picture is moved and turned",
        "screwed board; shift and rotation of the picture",
        ("shift", "px", 30.0),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "black-level",
        "the sensor's black is not at 0: dark places are lifted, and touches show less there",
        "dark current",
        ("level", "1", 0.3),
        false,
        false,
    ),
    CauseInfo::new(
        "coarse-pictures",
        "pictures are compressed: brightness comes in steps, and fine ridges are lost",
        "JPEG; rounding of the first coefficient of 8 x 8 pixels",
        ("step", "1", 0.12),
        false,
        false,
    ),
    CauseInfo::new(
        "rolling-rows",
        "rows of the picture are read one after another, the last one at the stamp",
        "rolling shutter",
        ("duration", "s", 0.3),
        false,
        true,
    ),
    // Elastomer.
    CauseInfo::new(
        "stiff-gel",
        "the elastomer is stiffer than its data sheet says",
        "cure and mixing ratio; linear elasticity knows force over modulus only",
        ("relative-change", "1", 2.0),
        false,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "yielding-gel",
        "the elastomer stiffens: displacement grows as F (1 + 9 F / F95)^-p",
        "power law of the force",
        ("power", "1", 0.8),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "creeping",
        "a reading that is held grows and stays for a while, over a continuous spectrum of times",
        "power-law (fractional) creep spectrum, 0.03 to 100 s",
        ("share", "1", 0.9),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo { size: ("share", "1", 0.9), ..common::STANDARD_SOLID },
    common::PREISACH_FRICTION,
    common::SLIPPING_ELEMENTS,
    common::DRAGGING_TIP,
    common::SOFT_SPOT,
    common::PERMANENT_SET,
    CauseInfo::new(
        "turned-skin",
        "in the second session the skin hangs another way, and its own weight bends it: nobody wrote that down",
        "gravity of a soft body",
        ("share-of-gravity", "1", 3.0),
        false,
        false,
    ),
    // The rig.
    loads::SCALED_FORCE,
    CauseInfo { size: ("relative-change", "1", 0.9), ..loads::WIDE_TIP },
    CauseInfo { size: ("shift", "m", 0.004), ..loads::SHIFTED_RIG },
    common::LATE_STAMPS,
    // What does not come again.
    CauseInfo::new(
        "passing-glare",
        "on some presses light from outside falls into a part of the picture",
        "thin elastomer lets light through",
        ("brightness", "1", 0.3),
        false,
        false,
    )
    .cell(Cell::DoesNotRepeat),
    CauseInfo::new(
        "bumped-camera",
        "from one moment on the camera sits beside its place, and the picture is moved",
        "a loose screw",
        ("shift", "px", 30.0),
        false,
        false,
    )
    .cell(Cell::DoesNotRepeat),
    common::STALE_FRAMES,
    CauseInfo { size: ("shift", "m", 0.008), ..common::BUMPED_MOUNT },
    // Numbers of the description that the device was not built with.
    CauseInfo::new(
        "built-gamma",
        "pictures are encoded by another power than the description says",
        "another profile of the camera",
        ("relative-change", "1", 0.6),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "built-exposure",
        "pictures are exposed for longer or shorter than the description says",
        "another setting of the camera",
        ("relative-change", "1", 0.8),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "built-focal",
        "the lens magnifies more or less than the description says",
        "another lens",
        ("relative-change", "1", 0.3),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
];

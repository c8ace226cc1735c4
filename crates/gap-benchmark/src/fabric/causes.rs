//! What can make a sheet over foam with electrodes differ from its design.

use crate::cause::{CauseInfo, Cell};
use crate::{common, loads};

/// All of them.
pub(crate) const CAUSES: &[CauseInfo] = &[
    // The sheet.
    CauseInfo::new(
        "displaced-electrodes",
        "every electrode was sewn beside its place, independently along both axes",
        "sewn by hand along a template",
        ("deviation", "m", 0.02),
        false,
        true,
    ),
    CauseInfo::new(
        "warp-and-weft",
        "the lower fabric resists more along x than along y",
        "woven fabrics have a direction",
        ("excess", "1", 1.5),
        false,
        true,
    ),
    CauseInfo::new(
        "drying-side",
        "the lower fabric dries from one side: its resistance rises along one direction, and more so as time goes on",
        "moisture of coated textiles; first-order uptake over a gradient",
        ("gradient", "1", 0.9),
        false,
        false,
    ),
    CauseInfo::new(
        "torn-patch",
        "around one place the lower fabric hardly conducts: it is torn, or its coating is rubbed off",
        "wear of conductive coatings",
        ("decades", "1", 3.0),
        false,
        false,
    ),
    // The foam.
    CauseInfo { size: ("share", "1", 0.9), ..common::PREISACH_FRICTION },
    common::SLIPPING_ELEMENTS,
    common::INNER_FRICTION,
    CauseInfo::new(
        "creeping-foam",
        "foam that is held conducts more and more, over a continuous spectrum of times",
        "power-law creep spectrum, 0.03 to 100 s",
        ("share", "1", 0.8),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    common::SOFTENING,
    common::SOFT_SPOT,
    common::PERMANENT_SET,
    // The rig.
    loads::SCALED_FORCE,
    loads::WIDE_TIP,
    loads::SHIFTED_RIG,
    // Wires, multiplexer and converter.
    CauseInfo::new(
        "poor-seams",
        "every electrode's seam resists, each a little differently",
        "contact resistance of sewn thread; log-normal",
        ("resistance", "ohm", 4e5),
        false,
        true,
    ),
    CauseInfo::new(
        "loosening-seams",
        "seams resist more and more, with the logarithm of time, each at a pace of its own",
        "fretting of contacts (Holm)",
        ("resistance-after-an-hour", "ohm", 1e6),
        false,
        false,
    ),
    CauseInfo::new(
        "leaking-switches",
        "every switch that is off lets a current through from the source: how far that pulls a reading depends on the panel",
        "off-resistance of analog multiplexers",
        ("conductance", "S", 1e-5),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "touching-thread",
        "a thread leads from one electrode to the top layer",
        "loose end of a conductive thread",
        ("conductance", "S", 1e-5),
        false,
        true,
    ),
    CauseInfo::new(
        "long-ground",
        "the way from the top layer to ground resists",
        "one lead for a whole panel",
        ("resistance", "ohm", 4e5),
        false,
        true,
    ),
    CauseInfo::new(
        "open-wire",
        "one electrode's wire is broken: fed, nothing flows; read, the converter keeps what it held of the channel before",
        "fatigue at a seam; charge of a sample-and-hold",
        ("loss", "1", 1.0),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "swapped-wires",
        "two wires were exchanged when the panel was connected",
        "a mistake of assembly",
        ("exchanged", "1", 1.0),
        false,
        true,
    ),
    CauseInfo::new(
        "slow-scan",
        "injections happen one after another before the stamp of their frame",
        "sequential conversion",
        ("duration", "s", 0.4),
        false,
        true,
    ),
    CauseInfo::new(
        "charging-wires",
        "wires take time to charge: each keeps a share of its own of the injection before",
        "time constant of wire and sheet against the dwell of the multiplexer",
        ("share", "1", 0.6),
        false,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "sinking-reference",
        "the converter's reference settles for minutes after power-on, and all voltages with it",
        "self-heating of a reference; two exponentials",
        ("start", "1", 0.05),
        true,
        true,
    )
    .cell(Cell::OtherLaw),
    CauseInfo::new(
        "warm-fabric",
        "warm fabric conducts better, exponentially in the temperature",
        "thermally activated conduction",
        ("coefficient", "1/K", 0.12),
        true,
        true,
    )
    .cell(Cell::OtherLaw),
    common::LATE_STAMPS,
    CauseInfo { size: ("amplitude", "V", 0.2), ..common::MAINS_INTERFERENCE },
    common::WARMING_UP,
    common::WEARING,
    common::WEARING_LOGARITHMIC,
    // What does not come again.
    CauseInfo::new(
        "rubbed-charge",
        "each press leaves another charge on fabric and foam, and all electrodes read a little more or less",
        "triboelectricity",
        ("deviation", "V", 0.3),
        false,
        false,
    )
    .cell(Cell::DoesNotRepeat),
    CauseInfo { size: ("deviation", "V", 1.0), ..common::CABLE_TUG },
    common::STALE_FRAMES,
    CauseInfo { size: ("shift", "m", 0.05), ..common::BUMPED_MOUNT },
    // Numbers of the description that the device was not built with.
    CauseInfo::new(
        "built-conductance",
        "pressed foam conducts more or less than its description says",
        "another batch of foam",
        ("relative-change", "1", 0.8),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "built-exponent",
        "the foam's conductance follows the pressure more steeply than its description says",
        "another batch of foam",
        ("change", "1", 1.0),
        false,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "built-fabric",
        "the lower fabric resists more or less than its description says, everywhere alike",
        "another batch of fabric",
        ("relative-change", "1", 0.8),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "built-electrodes",
        "electrodes are larger or smaller discs than their description says",
        "another stitch",
        ("relative-change", "1", 0.9),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
    CauseInfo::new(
        "built-cover",
        "the top layer is thicker or thinner than its description says",
        "another roll of material",
        ("relative-change", "1", 0.8),
        true,
        true,
    )
    .cell(Cell::DesignNumber),
];

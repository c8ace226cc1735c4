//! What makes a device differ from its design.

use std::path::Path;

use anyhow::{Result, bail};
use clap::Args;
use dermis_report::effects as report;
use dermis_sensor::Sensor;
use dermis_skin::SkinDescription;

use crate::registry::sensors;

/// Whose effects.
#[derive(Args)]
pub struct Options {
    /// Sensor family, or a skin description, which may switch some of them on; all families where absent.
    of: Option<String>,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Lists effects.
pub fn run(options: &Options) -> Result<()> {
    let (families, skin): (Vec<&'static dyn Sensor>, Option<SkinDescription>) = match &options.of {
        None => (sensors().iter().collect(), None),
        Some(of) => match sensors().get(of) {
            Some(family) => (vec![family], None),
            None if Path::new(of).exists() => {
                let skin = SkinDescription::load(of)?;
                (vec![crate::registry::family(&skin)?], Some(skin))
            }
            None => {
                let known = sensors().names();
                bail!("`{of}` is neither a sensor family ({}) nor a skin description file", known.join(", "))
            }
        },
    };
    if let Some(skin) = &skin {
        // Unknown names and impossible values are for the model to refuse.
        families[0].model(skin)?;
    }
    if options.json {
        println!("{}", report::record(&families, skin.as_ref())?);
    } else {
        print!("{}", report::text(&families, skin.as_ref()));
    }
    Ok(())
}

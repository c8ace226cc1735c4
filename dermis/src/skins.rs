//! Checking skin descriptions.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use dermis_skin::SkinDescription;

/// Which file.
#[derive(Args)]
pub struct Options {
    /// Skin description.
    skin: PathBuf,
    /// One JSON object.
    #[arg(long)]
    json: bool,
}

/// Prints what the description says, or the sentence that says what is wrong with it.
pub fn run(options: &Options) -> Result<()> {
    let skin = SkinDescription::load(&options.skin)?;
    let family = crate::registry::family(&skin)?;
    family.check(&skin).map_err(|error| error.in_file(&options.skin))?;
    let surface = skin.surface();
    let area: f64 = surface.areas.iter().sum();
    let model = family.model(&skin);
    if options.json {
        println!(
            "{}",
            serde_json::json!({
                "name": skin.name, "sensor": skin.sensor, "hash": skin.hash(), "unit": skin.unit,
                "taxels": skin.taxels.len(), "channels": skin.channels().len(), "rate_hz": skin.rate,
                "surface_points": surface.points.len(), "area_m2": area,
                "forward_model": model.as_ref().err().map_or("yes".to_owned(), ToString::to_string),
            })
        );
        return Ok(());
    }
    println!("{}: {}", skin.name, skin.description);
    println!("  sensor family  {}", skin.sensor);
    println!(
        "  taxels         {} with {} channels in {}, {} frames/s",
        skin.taxels.len(),
        skin.channels().len(),
        skin.unit,
        skin.rate
    );
    println!(
        "  surface        {:.2} cm² in {} points, frame {}",
        area * 1e4,
        surface.points.len(),
        skin.frame_id
    );
    match model {
        Ok(_) => println!("  forward model  yes: it can be simulated"),
        Err(e) => println!("  forward model  none: {e}"),
    }
    println!("  hash           {}", skin.hash());
    Ok(())
}

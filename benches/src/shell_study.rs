//! How close shells on ever finer triangles come to solids, by both theories: what the mesh and the theory of a skin's model leave
//! out, and what closing that costs.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use dermis_hapdef::verify::{Converged, convergence};
use dermis_mechanics::shell::PlateTheory;
use dermis_skin::SkinDescription;
use serde_json::{Value, json};

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// Skin description: gauges on a panel.
    #[arg(long, default_value = "launch/skins/hapdef-shin.toml")]
    skin: PathBuf,
    /// How often triangles are split into four at most. Twice makes 72,000 nodes of the limb, which take two gigabytes.
    #[arg(long, default_value_t = 2)]
    halvings: usize,
}

/// Measures every shell beside the same solids.
///
/// # Errors
///
/// Where CalculiX is not installed or fails, or the skin makes no solids.
pub fn run(options: &Options) -> Result<Value> {
    let skin = SkinDescription::load(options.root.join(&options.skin))?;
    let rows = convergence(&skin, options.halvings)?.context(
        "the triangles of the skin's surface do not join to quadrilaterals, which solids are raised on: name a skin with a surface of \
         `type = \"panel\"`",
    )?;
    eprintln!("{:<58}{:>10}{:>8}{:>8}{:>8}{:>8}", "", "unknowns", "scale", "RMS", "worst", "took");
    let row = |row: &Converged| {
        let name = name(row);
        eprintln!(
            "{name:<58}{:>10}{:>8.3}{:>6.1} %{:>6.1} %{:>6.1} s",
            row.unknowns.map_or_else(|| "-".to_owned(), |unknowns| unknowns.to_string()),
            row.scale,
            row.rms * 100.0,
            row.worst * 100.0,
            row.took.as_secs_f64()
        );
        json!({
            "shell": name, "halvings": row.halvings, "graded": row.graded, "unknowns": row.unknowns, "scale": row.scale,
            "rms": row.rms, "worst": row.worst, "took_s": row.took.as_secs_f64(),
        })
    };
    Ok(json!({
        "skin": skin.name,
        "reference": "20-node hexahedra on cells of half the size of the skin's, one through the thickness (CalculiX)",
        "rows": rows.iter().map(row).collect::<Vec<_>>(),
    }))
}

/// For people.
fn name(row: &Converged) -> String {
    let what = match row.theory {
        None => return "solids on the cells of the skin, one through the thickness".to_owned(),
        Some(PlateTheory::KirchhoffLove) => "thin",
        Some(PlateTheory::ReissnerMindlin) => "shears",
    };
    let size = match row.halvings {
        0 => "triangles of the skin".to_owned(),
        times => format!("triangles of 1/{} the size", 1_u32 << times.min(31)),
    };
    let graded = if row.graded { ", finer at edges and corners" } else { "" };
    format!("{what}, {size}{graded}")
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn meshes_are_called_by_what_they_are() {
        let row = |theory, halvings, graded| Converged {
            theory,
            halvings,
            graded,
            unknowns: None,
            scale: 1.0,
            rms: 0.0,
            worst: 0.0,
            took: Duration::ZERO,
        };
        assert_eq!(name(&row(Some(PlateTheory::KirchhoffLove), 0, false)), "thin, triangles of the skin");
        assert_eq!(
            name(&row(Some(PlateTheory::ReissnerMindlin), 2, true)),
            "shears, triangles of 1/4 the size, finer at edges and corners"
        );
        assert!(name(&row(None, 0, false)).starts_with("solids"));
    }
}

//! What speaks for "unknown": numbers that a right name and a wrong one leave in different ways.

use std::collections::BTreeMap;

use super::data::Data;
use super::predict::Explained;
use crate::rivals::{Remains, Rival};

/// What is measured of names and of what they leave. Shares are of the systematic gap.
pub(super) fn tests(
    data: &Data<'_>,
    explained: &Explained,
    rivals: &[Rival],
    remains: &Remains,
) -> BTreeMap<String, f64> {
    let systematic = data.gap.systematic.max(1e-12);
    let selection = &explained.selection;
    let mut found = BTreeMap::new();
    let mut put = |name: String, value: f64| {
        if value.is_finite() {
            found.insert(name, value);
        }
    };
    put("left".to_owned(), remains.left);
    for (shape, share, _) in &remains.beyond {
        put(format!("beyond-{}", shape.name()), *share);
    }
    let excess = rivals.iter().filter_map(|r| r.excess).fold(f64::NEG_INFINITY, f64::max);
    put("excess".to_owned(), excess);
    let named = &explained.named;
    let plausibility = named.iter().flat_map(|n| &n.theta).filter_map(|v| v.plausibility).fold(1.0, f64::min);
    put("implausible".to_owned(), -plausibility.max(1e-6).ln());
    let alone = 1.0 - explained.library / systematic;
    put("alone".to_owned(), alone);
    let first_order = (selection.library - explained.library) / systematic;
    put("first-order".to_owned(), first_order);
    put("discrepancy".to_owned(), selection.discrepancy / systematic);
    put("size".to_owned(), (systematic / data.options.select.margin).ln());
    put("noise".to_owned(), (data.gap.floor / systematic).max(1e-6).ln());
    put("names".to_owned(), named.len() as f64);
    let per_channel =
        |label: &str| data.signatures.candidates.iter().any(|c| c.name == label && c.per_channel);
    put("per-channel".to_owned(), f64::from(u8::from(named.first().is_some_and(|n| per_channel(&n.label)))));
    let unwritten = named.iter().filter(|n| !n.written).count();
    put("unwritten".to_owned(), unwritten as f64);
    put("class".to_owned(), named.first().map_or(0.0, |n| n.class.len() as f64));
    put("own".to_owned(), named.iter().map(|n| n.gain).sum::<f64>() / systematic);
    found
}

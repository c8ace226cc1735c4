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

#[cfg(test)]
mod tests {
    use dermis_skin::Effect;

    use super::super::report::known_effect;
    use super::super::testing::{Case, with_simulator};
    use super::*;
    use crate::rivals::Shape;

    #[test]
    fn what_a_name_leaves_and_what_beats_it_is_measured() {
        with_simulator(|simulator| {
            let case = Case::of(simulator, &[Effect::new("channel-gain").with("a", 1.2).with("b", 0.9)]);
            let data = case.data(simulator);
            let systematic = data.gap.systematic;
            let remains = Remains { left: 0.3, beyond: Vec::new() };
            let of = |effect: Effect, change: fn(&mut Explained, f64), rivals: &[Rival]| {
                let mut named = known_effect(&effect, "", "");
                (named.gain, named.class) = (0.25 * systematic, vec![]);
                let mut explained = Explained { named: vec![named], ..Explained::default() };
                explained.library = 0.8 * systematic;
                change(&mut explained, systematic);
                tests(&data, &explained, rivals, &remains)
            };
            let gain = Effect::new("channel-gain").with("a", 1.2);
            let found = of(gain.clone(), |_, _| {}, &[]);
            assert_eq!((found["left"], found["names"], found["per-channel"]), (0.3, 1.0, 1.0));
            assert!((found["alone"] - 0.2).abs() < 1e-12 && (found["own"] - 0.25).abs() < 1e-12);
            // Nothing competes, so that nothing says by how much.
            assert!(!found.contains_key("excess"));
            let rival = |excess| Rival {
                shape: Shape::Place,
                what: String::new(),
                explains: 0.5,
                excess: Some(excess),
                deviations: None,
            };
            assert_eq!(of(gain.clone(), |_, _| {}, &[rival(-0.1), rival(0.2)])["excess"], 0.2);
            let strange = |explained: &mut Explained, systematic: f64| {
                explained.named[0].theta[0].plausibility = Some(1e-3);
                explained.named[0].written = false;
                explained.selection.library = 0.9 * systematic;
            };
            let doubted = of(gain, strange, &[]);
            assert!((doubted["implausible"] - 1e-3f64.ln().abs()).abs() < 1e-9);
            assert!((doubted["first-order"] - 0.1).abs() < 1e-9 && doubted["unwritten"] == 1.0);
            assert_eq!(found["implausible"], 0.0);
            let scale = of(Effect::new("force-scale").with("factor", 1.1), |_, _| {}, &[]);
            assert_eq!(scale["per-channel"], 0.0);
        });
    }
}

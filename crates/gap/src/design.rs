//! Numbers of a skin's description as hypotheses: a device may have been built with others than its description says.
//!
//! The description is taken as TOML values. Every number of the medium counts, whatever table or list it stands in, and every number that
//! all taxels have in common; lists of more than a few numbers are patterns, and no single number. None is known here by its name: what
//! the model does not read moves no reading, and a count that must be whole is refused by the model when it is moved by a part of it.
//!
//! A hypothesis is written as an [`Effect`] whose name is the path of the number (`medium.layers[0].thickness`, `taxels[*].position[2]`)
//! and whose parameter [`VALUE`] is its value. [`Simulator::with`](crate::Simulator::with) puts it into the description itself.

use dermis_skin::{Effect, SkinDescription, Taxel};
use toml::Value;

use crate::constants::signatures::{LIST, REACH, WITHIN};
use crate::nonlinear_refinement::Free;

/// Parameter of an effect that stands for a number: what the number is.
pub(crate) const VALUE: &str = "value";

/// A number of a description.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Number {
    /// Where it stands.
    pub path: String,
    /// What it is by design; never 0.
    pub value: f64,
}

/// All numbers of a description that a device could have been built without.
pub(crate) fn numbers(skin: &SkinDescription) -> Vec<Number> {
    let mut found = Vec::new();
    for (key, value) in skin.medium.iter().filter(|(key, _)| plain(key)) {
        walk(value, &format!("medium.{key}"), &mut found);
    }
    if let Ok(Value::Array(taxels)) = Value::try_from(&skin.taxels) {
        // Directions are of unit length, whatever a device is built with.
        let common = elements(&taxels, "taxels").0;
        found.extend(common.into_iter().filter(|n| n.path.starts_with("taxels[*].position")));
    }
    found
}

/// What the number at `path` is; `None` where no number stands there.
pub(crate) fn value(skin: &SkinDescription, path: &str) -> Option<f64> {
    if !is_path(path) {
        return None;
    }
    if let Some(rest) = path.strip_prefix("medium.") {
        let key = &rest[..rest.find(['.', '[']).unwrap_or(rest.len())];
        return get(skin.medium.get(key)?, &rest[key.len()..]);
    }
    get(&Value::try_from(&skin.taxels).ok()?, path.strip_prefix("taxels")?)
}

/// Makes the number at `path` another one; `false` where no number stands there.
pub(crate) fn put(skin: &mut SkinDescription, path: &str, to: f64) -> bool {
    if !is_path(path) {
        return false;
    }
    if let Some(rest) = path.strip_prefix("medium.") {
        let key = &rest[..rest.find(['.', '[']).unwrap_or(rest.len())];
        return skin.medium.get_mut(key).is_some_and(|value| set(value, &rest[key.len()..], to));
    }
    let Some(rest) = path.strip_prefix("taxels") else { return false };
    let Ok(mut taxels) = Value::try_from(&skin.taxels) else { return false };
    match set(&mut taxels, rest, to).then(|| taxels.try_into::<Vec<Taxel>>()) {
        Some(Ok(taxels)) => {
            skin.taxels = taxels;
            true
        }
        _ => false,
    }
}

/// The hypothesis that a number is another one.
pub(crate) fn hypothesis(path: &str, value: f64) -> Effect {
    Effect::new(path).with(VALUE, value)
}

/// What is fitted of a hypothesis: its value, from a fifth to five times what the description says.
pub(crate) fn free(skin: &SkinDescription, hypothesis: &Effect) -> Option<Free> {
    let nominal = value(skin, &hypothesis.name)?;
    Some(Free {
        effect: hypothesis.name.clone(),
        parameter: VALUE.to_owned(),
        limits: limits(nominal),
        scale: REACH * nominal.abs(),
        typical: nominal,
        neutral: nominal,
    })
}

/// A linear fit's value within what is fitted.
pub(crate) fn within(nominal: f64, value: f64) -> f64 {
    let [low, high] = limits(nominal);
    value.clamp(low, high)
}

fn limits(nominal: f64) -> [f64; 2] {
    let (a, b) = (nominal / WITHIN, nominal * WITHIN);
    [a.min(b), a.max(b)]
}

/// Names of effects are words joined by `-`.
fn is_path(name: &str) -> bool {
    name.contains(['.', '['])
}

/// Keys that a path can name.
fn plain(key: &str) -> bool {
    !key.contains(['.', '[', ']'])
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64))
}

fn walk(value: &Value, path: &str, found: &mut Vec<Number>) {
    match value {
        Value::Table(table) => {
            for (key, value) in table.iter().filter(|(key, _)| plain(key)) {
                walk(value, &format!("{path}.{key}"), found);
            }
        }
        Value::Array(list) if list.iter().all(|v| number(v).is_some()) => {
            for (i, value) in list.iter().enumerate().filter(|_| list.len() <= LIST) {
                walk(value, &format!("{path}[{i}]"), found);
            }
        }
        Value::Array(list) => {
            let (common, own) = elements(list, path);
            found.extend(common);
            if list.len() <= LIST {
                found.extend(own);
            }
        }
        _ => {
            let of = number(value).filter(|v| v.is_finite() && *v != 0.0);
            found.extend(of.map(|value| Number { path: path.to_owned(), value }));
        }
    }
}

/// Numbers of a list of tables: those that all elements have in common, once, and those of single elements.
fn elements(list: &[Value], path: &str) -> (Vec<Number>, Vec<Number>) {
    let of: Vec<Vec<Number>> = list
        .iter()
        .map(|element| {
            let mut found = Vec::new();
            walk(element, "", &mut found);
            found
        })
        .collect();
    let (mut common, mut own) = (Vec::new(), Vec::new());
    let shared = |n: &Number| list.len() > 1 && of.iter().all(|other| other.contains(n));
    for (i, numbers) in of.iter().enumerate() {
        for n in numbers {
            if !shared(n) {
                own.push(Number { path: format!("{path}[{i}]{}", n.path), value: n.value });
            } else if i == 0 {
                common.push(Number { path: format!("{path}[*]{}", n.path), value: n.value });
            }
        }
    }
    (common, own)
}

/// First step of a path, and the rest of it.
fn step(path: &str) -> Option<(Step<'_>, &str)> {
    if let Some(rest) = path.strip_prefix('.') {
        let (key, rest) = rest.split_at(rest.find(['.', '[']).unwrap_or(rest.len()));
        return Some((Step::Key(key), rest));
    }
    let (index, rest) = path.strip_prefix('[')?.split_once(']')?;
    let step = if index == "*" { Step::Each } else { Step::At(index.parse().ok()?) };
    Some((step, rest))
}

enum Step<'a> {
    Key(&'a str),
    At(usize),
    Each,
}

fn get(value: &Value, path: &str) -> Option<f64> {
    if path.is_empty() {
        return number(value);
    }
    match step(path)? {
        (Step::Key(key), rest) => get(value.get(key)?, rest),
        (Step::At(index), rest) => get(value.get(index)?, rest),
        (Step::Each, rest) => get(value.get(0)?, rest),
    }
}

fn set(value: &mut Value, path: &str, to: f64) -> bool {
    if path.is_empty() {
        let known = number(value).is_some();
        if known {
            *value = Value::Float(to);
        }
        return known;
    }
    match step(path) {
        Some((Step::Key(key), rest)) => value.get_mut(key).is_some_and(|v| set(v, rest, to)),
        Some((Step::At(index), rest)) => value.get_mut(index).is_some_and(|v| set(v, rest, to)),
        Some((Step::Each, rest)) => value
            .as_array_mut()
            .is_some_and(|list| !list.is_empty() && list.iter_mut().all(|v| set(v, rest, to))),
        None => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nested() -> SkinDescription {
        let mut skin = crate::testing::skin();
        let text = "count = 3\nname = \"x\"\n[[layers]]\nthickness = 0.002\nmodulus = 7e4\n[[layers]]\nthickness = 0.003\nmodulus = 7e4\n\
                    [pipe]\nbore = 1.5e-3\nknots = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]\nsize = [0.1, 0.0]\n";
        skin.medium.extend(toml::from_str::<toml::Table>(text).unwrap());
        skin
    }

    #[test]
    fn every_number_is_found_where_it_stands() {
        let skin = nested();
        let mut found: Vec<String> = numbers(&skin).into_iter().map(|n| n.path).collect();
        found.sort_unstable();
        // What all layers or taxels share is one number; what is 0 has no tolerance, and a long list is a pattern.
        let all = [
            "medium.count",
            "medium.layers[*].modulus",
            "medium.layers[0].thickness",
            "medium.layers[1].thickness",
            "medium.pipe.bore",
            "medium.pipe.size[0]",
            "medium.spread",
            "taxels[*].position[2]",
        ];
        assert_eq!(found, all);
        for n in numbers(&skin) {
            assert_eq!(value(&skin, &n.path), Some(n.value), "{}", n.path);
        }
    }

    #[test]
    fn a_number_is_put_where_it_stands() {
        let mut skin = nested();
        assert!(put(&mut skin, "medium.pipe.bore", 1e-3) && put(&mut skin, "taxels[*].position[2]", -0.004));
        assert!(put(&mut skin, "medium.layers[*].modulus", 9e4));
        assert_eq!(value(&skin, "medium.pipe.bore"), Some(1e-3));
        assert_eq!(value(&skin, "medium.layers[1].modulus"), Some(9e4));
        assert!(skin.taxels.iter().all(|t| t.position[2] == -0.004));
        for wrong in
            ["medium.pipe.nothing", "medium.name", "channel-gain", "taxels[9].position[2]", "medium.pipe"]
        {
            assert!(!put(&mut skin, wrong, 1.0) && value(&skin, wrong).is_none(), "{wrong}");
        }
    }

    #[test]
    fn values_are_fitted_on_their_own_side_of_zero() {
        let skin = nested();
        let depth = free(&skin, &hypothesis("taxels[*].position[2]", -0.006)).unwrap();
        assert_eq!((depth.typical, depth.limits), (-0.005, [-0.025, -0.001]));
        assert_eq!(within(-0.005, 0.1), -0.001);
    }
}

//! The columns of a table: how each is called, what it is in, and how it is read of a sample.

use dermis_skin::SkinDescription;

use super::{Column, Values};
use crate::dataset::Truth;

/// The columns of a table, in their order.
pub(super) fn columns(skin: &SkinDescription, tared: bool) -> Vec<Column> {
    let mut all = frame_columns(skin, tared);
    all.extend(truth_columns());
    all.extend(contact_columns());
    all.push(one(
        "split",
        "",
        "train, held_out, or empty without ground truth",
        Values::Text(|held_out| match held_out {
            Some(true) => "held_out",
            Some(false) => "train",
            None => "",
        }),
    ));
    all
}

/// A column with one value a frame.
fn one(name: &'static str, unit: &str, meaning: &'static str, values: Values) -> Column {
    many(name, unit, meaning, Vec::new(), values)
}

/// A column with a value a frame for each of its parts.
fn many(name: &'static str, unit: &str, meaning: &'static str, parts: Vec<String>, values: Values) -> Column {
    Column { name, unit: unit.to_owned(), meaning, parts, values }
}

/// The reading of one channel, NaN where there is none.
fn reading(values: &[f32], i: usize) -> f32 {
    values.get(i).copied().unwrap_or(f32::NAN)
}

fn number(truth: Option<&Truth>, name: &str) -> f64 {
    truth.and_then(|t| t.value(name)).unwrap_or(f64::NAN)
}

fn axes() -> Vec<String> {
    ["x", "y", "z"].map(str::to_owned).to_vec()
}

/// A target along each axis.
fn along(name: [&'static str; 3]) -> Values {
    Values::Double(Box::new(move |s, i| number(s.truth.as_ref(), name[i])))
}

/// What the device gave.
fn frame_columns(skin: &SkinDescription, tared: bool) -> Vec<Column> {
    let channels: Vec<String> = skin.channels().iter().map(|c| c.name.clone()).collect();
    let mut all = vec![
        one(
            "stamp",
            "ns",
            "when the frame was acquired, since 1970",
            Values::Whole(Box::new(|s, _| s.frame.stamp)),
        ),
        one(
            "sequence",
            "1",
            "counts every frame of the device; a step > 1 is a loss",
            Values::Whole(Box::new(|s, _| s.frame.sequence.cast_signed())),
        ),
        many(
            "values",
            &skin.unit,
            "readings as the device gave them, NaN where invalid; channel.* in Parquet",
            channels.clone(),
            Values::Single(Box::new(|s, i| reading(&s.frame.values, i))),
        ),
    ];
    if tared {
        all.push(many(
            "tared",
            &skin.unit,
            "readings minus their zero, NaN where it is unknown",
            channels.clone(),
            Values::Single(Box::new(|s, i| reading(&s.tared, i))),
        ));
    }
    all.extend([
        many(
            "flags",
            "bits",
            "FLAG_* of dermis_msgs/TaxelFrame; 0 is healthy",
            channels,
            Values::Byte(Box::new(|s, i| s.frame.flags.get(i).map_or(0, |f| f.bits()))),
        ),
        one(
            "temperature",
            "K",
            "of the skin, NaN where unknown",
            Values::Single(Box::new(|s, _| s.frame.temperature)),
        ),
    ]);
    all
}

/// What the ground truth says of every frame that has it.
fn truth_columns() -> [Column; 4] {
    [
        one(
            "contacts",
            "1",
            "true contacts, -1 without ground truth",
            Values::Whole(Box::new(|s, _| s.truth.as_ref().map_or(-1, |t| t.contacts.len() as i64))),
        ),
        one(
            "idle",
            "1",
            "1 where it is known that nothing is near",
            Values::Byte(Box::new(|s, _| u8::from(s.truth.as_ref().is_some_and(|t| t.idle)))),
        ),
        one(
            "press",
            "1",
            "identity of the press within its session, -1 without ground truth",
            Values::Whole(Box::new(|s, _| s.truth.as_ref().map_or(-1, |t| t.press.cast_signed()))),
        ),
        one(
            "location",
            "1",
            "identity of the place, -1 without ground truth",
            Values::Whole(Box::new(|s, _| s.truth.as_ref().map_or(-1, |t| i64::from(t.location)))),
        ),
    ]
}

/// What the ground truth says of the only contact, and of the force.
fn contact_columns() -> [Column; 4] {
    [
        many(
            "position",
            "m",
            "first point of the only contact on the undeformed surface, in the skin's link",
            axes(),
            along(["position.x", "position.y", "position.z"]),
        ),
        many(
            "normal",
            "1",
            "out of the skin at the only contact",
            axes(),
            Values::Double(Box::new(|s, i| {
                s.truth.as_ref().and_then(Truth::single).map_or(f64::NAN, |c| c.normal[i])
            })),
        ),
        many(
            "force",
            "N",
            "exerted on the skin in its link, 0 where it is untouched",
            axes(),
            along(["force.x", "force.y", "force.z"]),
        ),
        one(
            "force_normal",
            "N",
            "pressing force, positive; 0 where it is untouched",
            Values::Double(Box::new(|s, _| number(s.truth.as_ref(), "force.normal"))),
        ),
    ]
}

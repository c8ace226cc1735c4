//! What a configuration may not say, part by part.

use dermis_inference::Taps;
use dermis_skin::ImageGrid;

use super::{InputForm, TrainConfig};
use crate::LearnError;
use crate::target::{MAP_NORMAL, Target};

/// Makes the error of a field.
type Wrong<'a> = &'a dyn Fn(&str, String) -> Result<(), LearnError>;

/// Says which targets cannot be learned.
pub(super) fn targets(config: &TrainConfig, wrong: Wrong<'_>) -> Result<(), LearnError> {
    let targets = &config.targets;
    if targets.is_empty() {
        return wrong("targets", "is empty: a model has at least one output".into());
    }
    for (i, target) in targets.iter().enumerate() {
        let field = format!("targets[{i}]");
        if Target::of(target).is_none() {
            let names = Target::names().collect::<Vec<_>>().join(", ");
            return wrong(&field, format!("is \"{target}\" and must be one of {names}"));
        }
        if targets[..i].contains(target) {
            return wrong(&field, format!("\"{target}\" is already taken"));
        }
    }
    let has = |name: &str| targets.iter().any(|t| t == name);
    if has("position.x") != has("position.y") {
        return wrong("targets", "position.x and position.y only make sense together".into());
    }
    Ok(())
}

/// Says which sizes of a network are impossible.
pub(super) fn network_size(config: &TrainConfig, wrong: Wrong<'_>) -> Result<(), LearnError> {
    let network = &config.network;
    if network.hidden.iter().any(|w| !(1..=8192).contains(w)) || network.hidden.len() > 32 {
        return wrong("network.hidden", "holds up to 32 widths of 1 to 8192".into());
    }
    if !(1..=64).contains(&network.members) {
        return wrong("network.members", format!("is {} and must be 1 to 64", network.members));
    }
    Ok(())
}

/// Says which inputs no model can take.
pub(super) fn input(config: &TrainConfig, wrong: Wrong<'_>) -> Result<(), LearnError> {
    let plain = config.network.input == InputForm::Plain;
    let newest_first = match &config.features.taps {
        Taps::Frames(delays) => delays.first() == Some(&0),
        Taps::Seconds(delays) => delays.first() == Some(&0.0),
    };
    if !plain && !newest_first {
        return wrong(
            "network.input",
            "`direction`, `ratios` and `logarithm` need the newest frame as the first of `features.taps`"
                .into(),
        );
    }
    if let Some(grid) = &config.features.image {
        let (numbers, most) = (grid.numbers(), ImageGrid::MOST);
        if !(1..=most).contains(&numbers) {
            return wrong("features.image", format!("has {numbers} numbers and must have 1 to {most}"));
        }
        if !plain {
            return wrong("network.input", "is for channels; leave it out, or `features.image`".into());
        }
    }
    Ok(())
}

/// Says what does not go together with a network that draws a picture, and what goes with that alone.
pub(super) fn image_network(config: &TrainConfig, wrong: Wrong<'_>) -> Result<(), LearnError> {
    if let Some(image) = &config.network.image {
        if let Err((field, reason)) = image.check() {
            return wrong(&field, reason);
        }
        if config.targets != [MAP_NORMAL] {
            let reason = format!("must be [\"{MAP_NORMAL}\"] alone where `network.image` draws it");
            return wrong("targets", reason);
        }
        if config.network.conv.is_some() {
            return wrong("network.conv", "stands beside `network.image`: name one of them".into());
        }
    }
    if let Some(noise) = &config.training.channel_noise {
        if config.network.image.is_none() {
            return wrong("training.channel_noise", "is for `network.image`; leave it out".into());
        }
        if !(noise.share >= 0.0 && noise.share.is_finite()) {
            let reason = format!("is {} and must be 0 or positive", noise.share);
            return wrong("training.channel_noise.share", reason);
        }
    }
    Ok(())
}

/// Says what is for dense networks only, where the network is another.
pub(super) fn dense_only(config: &TrainConfig, wrong: Wrong<'_>) -> Result<(), LearnError> {
    if config.network.conv.is_none() && config.network.image.is_none() {
        return Ok(());
    }
    for (field, used) in [
        ("network.members", config.network.members > 1),
        ("network.input", config.network.input != InputForm::Plain),
        ("balance_force", config.balance_force),
        ("training.noise", config.training.noise > 0.0),
        ("training.weight_decay", config.training.weight_decay > 0.0),
    ] {
        if used {
            return wrong(
                field,
                "is for dense networks; leave it out, or `network.conv` and `network.image`".into(),
            );
        }
    }
    Ok(())
}

/// Says which numbers of the training are out of their range.
pub(super) fn training(config: &TrainConfig, wrong: Wrong<'_>) -> Result<(), LearnError> {
    let t = &config.training;
    if t.epochs == 0 || t.batch == 0 {
        return wrong("training.epochs", "and `training.batch` must be at least 1".into());
    }
    if !(t.learning_rate > 0.0 && t.learning_rate.is_finite()) {
        return wrong("training.learning_rate", "must be positive".into());
    }
    if !(0.0..1.0).contains(&t.momentum) {
        return wrong("training.momentum", format!("is {} and must be 0 or more and below 1", t.momentum));
    }
    for (field, v) in [
        ("training.weight_decay", t.weight_decay),
        ("training.noise", t.noise),
        ("position_min_force", config.position_min_force),
        ("position_full_force", config.position_full_force),
    ] {
        if !(v >= 0.0 && v.is_finite()) {
            return wrong(field, format!("is {v} and must be 0 or positive"));
        }
    }
    if t.seed > i64::MAX.cast_unsigned() {
        return wrong("training.seed", "is beyond 2^63 - 1".into());
    }
    Ok(())
}

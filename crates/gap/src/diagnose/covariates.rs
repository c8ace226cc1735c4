//! What an effect follows in a recording, and what else does.

use dermis_model::diagnosis::Covariate;

use crate::constants::report::ALIAS;
use crate::effects;
use crate::report::NamedEffect;
use crate::samples::Samples;

/// What rises and falls with a covariate, for effects that follow it.
pub(super) fn alias(effects: &mut [NamedEffect], samples: &Samples) {
    let temperature: Vec<f64> = samples.list.iter().map(|s| s.temperature).collect();
    let others: [(&str, Vec<f64>); 2] = [
        ("session time", samples.list.iter().map(|s| s.time).collect()),
        ("session", samples.list.iter().map(|s| f64::from(s.session)).collect()),
    ];
    for effect in effects {
        let Some(Covariate::Temperature) = effects::of(&effect.label).follows else { continue };
        for (name, values) in &others {
            if correlation(&temperature, values).abs() > ALIAS {
                effect.covariate_alias.push(format!("anything that follows the {name}"));
            }
        }
    }
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().max(1) as f64;
    let (ma, mb) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let (mut xy, mut xx, mut yy) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        xy += (x - ma) * (y - mb);
        xx += (x - ma).powi(2);
        yy += (y - mb).powi(2);
    }
    xy / (xx * yy).sqrt().max(1e-300)
}

#[cfg(test)]
mod tests {
    use dermis_skin::Effect;

    use super::super::report::known_effect;
    use super::*;
    use crate::statistics::tests::samples;

    #[test]
    fn what_follows_the_temperature_may_be_what_follows_the_time() {
        let mut samples = samples(&[0; 20]);
        for (i, s) in samples.list.iter_mut().enumerate() {
            (s.time, s.temperature) = (i as f64, 293.0 + 0.1 * i as f64);
        }
        let of = |name: &str| known_effect(&Effect::new(name), "", "");
        let mut effects = [of("thermal-zero"), of("channel-gain")];
        alias(&mut effects, &samples);
        assert_eq!(effects[0].covariate_alias, ["anything that follows the session time"]);
        assert!(effects[1].covariate_alias.is_empty());
    }
}

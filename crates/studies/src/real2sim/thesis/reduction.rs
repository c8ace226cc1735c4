//! A run for a quarter of an hour in place of hours, that says what it leaves out.

use dermis_learn::real2sim::Settings;

use super::Request;

/// Epochs are divided by this,
const EPOCHS: u32 = 6;
/// and samples and frames by this.
const SAMPLES: usize = 4;
/// Numbers of virtual sensors near each element that stay.
const SENSORS: [usize; 2] = [4, 24];

/// Reduces epochs, samples, frames and numbers of virtual sensors; what was reduced, a sentence each.
pub(super) fn apply(settings: &mut Settings, options: &mut Request) -> Vec<String> {
    let mut said = Vec::new();
    let pipeline = &mut settings.pipeline;
    for (name, training) in [
        ("transfer", &mut pipeline.transfer_training),
        ("reconstruction", &mut pipeline.reconstruction_training),
        ("sensitivity", &mut pipeline.sensitivity_training),
    ] {
        let whole = training.epochs;
        training.epochs = (whole / EPOCHS).max(1);
        said.push(format!("{} of {whole} epochs of the {name} network", training.epochs));
    }
    let whole = pipeline.samples;
    pipeline.samples = whole.map(|count| count.div_ceil(SAMPLES));
    said.push(format!("{:?} of {whole:?} simulated scenes of one to four contacts", pipeline.samples));
    let whole = settings.most;
    settings.most = whole.div_ceil(SAMPLES);
    said.push(format!("{} of {whole} recorded contacts at most", settings.most));
    let whole = options.most;
    options.most = whole.div_ceil(SAMPLES);
    said.push(format!("{} of {whole} frames of each kind at most", options.most));
    let whole = options.sensors.len();
    options.sensors.retain(|each| SENSORS.contains(each));
    said.push(format!("{} of {whole} numbers of virtual sensors", options.sensors.len()));
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_that_is_reduced_is_said_and_sizes_stay() {
        let (mut settings, mut options) = (Settings::default(), Request::default());
        let whole = settings.clone();
        let said = apply(&mut settings, &mut options);
        insta::assert_snapshot!(said.join("\n"), @r"
        13 of 80 epochs of the transfer network
        10 of 60 epochs of the reconstruction network
        20 of 120 epochs of the sensitivity network
        [4050, 900, 900, 900] of [16200, 3600, 3600, 3600] simulated scenes of one to four contacts
        6750 of 27000 recorded contacts at most
        375 of 1500 frames of each kind at most
        2 of 5 numbers of virtual sensors
        ");
        let (now, before) = (&settings.pipeline, &whole.pipeline);
        assert_eq!(now.transfer, before.transfer);
        assert_eq!(now.reconstruction, before.reconstruction);
        assert_eq!(now.sensitivity, before.sensitivity);
        // Once more, of one epoch: never none.
        settings.pipeline.transfer_training.epochs = 1;
        apply(&mut settings, &mut options);
        assert_eq!(settings.pipeline.transfer_training.epochs, 1);
    }
}

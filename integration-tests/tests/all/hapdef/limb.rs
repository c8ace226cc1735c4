//! A limb behind a pseudo-terminal that does what it is told.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use dermis_model::{ForwardModel, Indentation, Stimulus};
use dermis_skin::SkinDescription;
use dermis_transport::Pty;
use dermis_transport::framing::{NativeEncoder, NativeFormat};
use nalgebra::{Point3, Vector3};

use super::{FORCE, TIP, place, shin};

/// Presses the middle of the shin.
pub(super) const PRESS: u8 = 1;
/// g1 is at the upper end of its range.
pub(super) const FAILED: u8 = 2;
/// Presses the shin in two locations.
pub(super) const TWO: u8 = 4;

/// The model of the shin, made once.
pub(super) fn model() -> &'static Arc<dyn ForwardModel> {
    static MODEL: OnceLock<Arc<dyn ForwardModel>> = OnceLock::new();
    MODEL.get_or_init(|| dermis_hapdef::model(&SkinDescription::load(shin()).unwrap()).unwrap())
}

/// Where and in which direction [`PRESS`] presses.
pub(super) fn pressed() -> (Point3<f64>, Vector3<f64>) {
    place(model().surface(), 0.02, 0.0)
}

/// Where [`TWO`] presses.
pub(super) fn both() -> [Point3<f64>; 2] {
    [place(model().surface(), 0.03, 0.005).0, place(model().surface(), -0.04, -0.02).0]
}

/// Presses of [`FORCE`] in these locations.
pub(super) fn presses(locations: &[Point3<f64>]) -> Vec<Indentation> {
    let press = |at: &Point3<f64>| {
        let (position, normal) = model().surface().project(at);
        Indentation::sphere(position, -normal * FORCE, TIP)
    };
    locations.iter().map(press).collect()
}

/// What the gauges read of these presses.
pub(super) fn strain(contacts: Vec<Indentation>) -> Vec<f64> {
    let mut strain = vec![0.0; 10];
    model().response(&Stimulus { contacts, ..Stimulus::default() }, &mut strain).unwrap();
    strain
}

/// A limb; it does what its mode says until it is dropped.
pub(super) struct Limb {
    mode: Arc<AtomicU8>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Limb {
    /// Frames a second.
    pub(super) const RATE: u32 = 100;

    /// With a gauge whose wire was never connected.
    pub(super) fn plug(link: &Path) -> Self {
        Self::made(link, Some(6), [1.0; 10])
    }

    /// With a gauge that is not connected, and gauges that read so many times what the design says.
    pub(super) fn made(link: &Path, open: Option<usize>, gains: [f64; 10]) -> Self {
        let skin = SkinDescription::load(shin()).unwrap();
        let one = strain(presses(&[pressed().0]));
        let two = strain(presses(&both()));
        let mode = Arc::new(AtomicU8::new(0));
        let stop = Arc::new(AtomicBool::new(false));
        let (current, ended) = (Arc::clone(&mode), Arc::clone(&stop));
        let mut pty = Pty::open().unwrap();
        pty.link(link).unwrap();
        let thread = std::thread::spawn(move || {
            let mut encoder = NativeEncoder::new(NativeFormat::U16);
            let mut random = 1_u64;
            let mut noise = move || {
                let mut uniform = || {
                    random = random
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1_442_695_040_888_963_407);
                    (random >> 40) as f64 / f64::from(1_u32 << 23) - 1.0
                };
                skin.noise * (uniform() + uniform() + uniform())
            };
            let begun = Instant::now();
            for k in 0_u32.. {
                if ended.load(Ordering::Acquire) {
                    return;
                }
                let mode = current.load(Ordering::Acquire);
                let share = |flag: u8| if mode & flag != 0 { 1.0 } else { 0.0 };
                let mut counts: Vec<f32> = one
                    .iter()
                    .zip(&two)
                    .zip(&gains)
                    .map(|((one, two), gain)| gain * (one * share(PRESS) + two * share(TWO)))
                    .map(|s| ((s + noise() - skin.wire.offset) / skin.wire.scale).round() as f32)
                    .collect();
                if let Some(open) = open {
                    counts[open] = 0.0;
                }
                if mode & FAILED != 0 {
                    counts[1] = 4095.0;
                }
                let time = u64::from(k) * u64::from(1_000_000 / Self::RATE) + 1;
                let _ = pty.write_lossy(encoder.encode(k, time, &counts).unwrap());
                let next = begun + Duration::from_secs(1) / Self::RATE * (k + 1);
                std::thread::sleep(next.saturating_duration_since(Instant::now()));
            }
        });
        Self { mode, stop, thread: Some(thread) }
    }

    pub(super) fn becomes(&self, mode: u8) {
        self.mode.store(mode, Ordering::Release);
    }
}

impl Drop for Limb {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

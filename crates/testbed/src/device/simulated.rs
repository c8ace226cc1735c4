//! A modelled skin as a device, in real time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dermis_model::ForwardModel;
use dermis_msgs::msg::Indentation;
use dermis_sensor::Encoder;
use dermis_skin::{Frame, SkinDescription, Stamp};
use dermis_transport::now_ns;

use super::line::Line;
use super::script::Script;
use super::worker::{Worker, sleep_until};
use super::{Counters, DeviceStats, Outlet, plain_encoder};
use crate::{GroundTruth, Plan, Sampler, TestbedError};

/// \[s\] between two checks for requests of the host.
const LISTEN: f64 = 0.002;
/// \[s\] behind its time after which a device leaves frames out: it was stopped, and does not send what it did not measure.
const LATE: f64 = 0.5;

/// A modelled skin as a device that sends frames at the skin's rate, in real time, until it is stopped or dropped.
///
/// ```no_run
/// use dermis_testbed::{Outlet, Plan, TestbedError, VirtualDevice};
/// # use dermis_model::ForwardModel;
/// # use dermis_skin::SkinDescription;
///
/// # fn plug_in(model: std::sync::Arc<dyn ForwardModel>, skin: &SkinDescription) -> Result<(), TestbedError> {
/// let plan = Plan::random_touches(0.004, [0.1, 1.0]);
/// let device = VirtualDevice::start(model, skin, &plan, 1, &Outlet::Pty)?;
/// println!("open {} and read", device.url());
/// # Ok(())
/// # }
/// ```
pub struct VirtualDevice {
    url: String,
    skin: SkinDescription,
    pub(super) script: Arc<Script>,
    counters: Arc<Counters>,
    worker: Worker,
}

impl std::fmt::Debug for VirtualDevice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("VirtualDevice")
            .field("skin", &self.skin.name)
            .field("url", &self.url)
            .field("stats", &self.stats())
            .finish_non_exhaustive()
    }
}

impl VirtualDevice {
    /// Plugs the modelled skin in at `outlet` and carries out `plan` on it, over and over; each round draws
    /// anew from `seed`. It speaks one of the wires that every family knows.
    ///
    /// # Errors
    ///
    /// [`TestbedError`] where model, skin and plan don't fit together, or there is no line to send on.
    pub fn start(
        model: Arc<dyn ForwardModel>,
        skin: &SkinDescription,
        plan: &Plan,
        seed: u64,
        outlet: &Outlet,
    ) -> Result<Self, TestbedError> {
        Self::start_on(plain_encoder(skin)?, model, skin, plan, seed, outlet)
    }

    /// [`start`](Self::start) with a wire of the sensor family's own.
    ///
    /// # Errors
    ///
    /// As [`start`](Self::start).
    pub fn start_on(
        encoder: Box<dyn Encoder>,
        model: Arc<dyn ForwardModel>,
        skin: &SkinDescription,
        plan: &Plan,
        seed: u64,
        outlet: &Outlet,
    ) -> Result<Self, TestbedError> {
        Self::plug(encoder, model, skin, plan, seed, outlet)?.start()
    }

    /// A device as of [`start_on`](Self::start_on) that is connected, and silent until it is started: what reads it may get ready first.
    ///
    /// # Errors
    ///
    /// As [`start`](Self::start).
    pub fn plug(
        encoder: Box<dyn Encoder>,
        model: Arc<dyn ForwardModel>,
        skin: &SkinDescription,
        plan: &Plan,
        seed: u64,
        outlet: &Outlet,
    ) -> Result<PluggedDevice, TestbedError> {
        let noise_seed = seed ^ 0x5eed_0001;
        // Whether they belong together, before a line is opened.
        drop(Sampler::new(model.as_ref(), skin, noise_seed)?);
        let (line, url) = Line::open(outlet, &skin.name)?;
        let script = Script::new(plan.clone(), Arc::clone(&model), seed)?;
        // A model may build tables when it is touched for the first time: not while frames are due.
        let warm_up = script.first_touch();
        Sampler::new(model.as_ref(), skin, noise_seed)?
            .warm_up(&warm_up.stimulus)
            .map_err(|source| TestbedError::Model { press: warm_up.press, source })?;
        Ok(PluggedDevice { url, skin: skin.clone(), script, encoder, model, line, noise_seed })
    }

    /// Source URL under which a node reads the device.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// What really touched the skin at `stamp`; `None` before the device was started, and for what happened so
    /// long ago that it is forgotten (four rounds of the plan).
    #[must_use]
    pub fn truth(&self, stamp: Stamp) -> Option<GroundTruth> {
        let t = (stamp - self.script.start) as f64 * 1e-9;
        if t < 0.0 {
            return None;
        }
        // The next round may begin before its first frame is due; that it fits was seen in the first.
        let at = |t: f64| self.script.at(t).ok().flatten();
        let mut moment = at(t)?;
        // What effects do to what touches depends on the frame before at most.
        let mut state = self.script.model.start(0);
        let before = t - 1.0 / self.skin.rate;
        if let Some(mut last) = at(before) {
            state.apply_to_stimulus(before, &mut last.stimulus);
        }
        state.apply_to_stimulus(t, &mut moment.stimulus);
        Some(moment)
    }

    /// [`truth`](Self::truth) as a message.
    #[must_use]
    pub fn truth_message(&self, stamp: Stamp) -> Option<Indentation> {
        let session = format!("{}/{}", self.script.plan.name, self.script.seed);
        self.truth(stamp).map(|m| m.message(&self.skin, self.script.model.surface(), &session, stamp))
    }

    /// What was sent so far.
    #[must_use]
    pub fn stats(&self) -> DeviceStats {
        self.counters.read()
    }

    /// Whether it is still sending; `false` after its line was lost, for the reason that [`stop`](Self::stop) returns.
    #[must_use]
    pub fn running(&self) -> bool {
        self.worker.running()
    }

    /// Ends the thread and closes the line.
    ///
    /// # Errors
    ///
    /// [`TestbedError`] that ended the device before.
    pub fn stop(mut self) -> Result<DeviceStats, TestbedError> {
        self.worker.stop()?;
        Ok(self.stats())
    }
}

/// A device that is connected and sends nothing yet.
pub struct PluggedDevice {
    url: String,
    skin: SkinDescription,
    script: Script,
    encoder: Box<dyn Encoder>,
    model: Arc<dyn ForwardModel>,
    line: Line,
    noise_seed: u64,
}

impl std::fmt::Debug for PluggedDevice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PluggedDevice")
            .field("skin", &self.skin.name)
            .field("url", &self.url)
            .finish_non_exhaustive()
    }
}

impl PluggedDevice {
    /// Source URL under which a node reads the device.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Begins the plan, and sends.
    ///
    /// # Errors
    ///
    /// [`TestbedError::Device`] where its thread does not start.
    pub fn start(self) -> Result<VirtualDevice, TestbedError> {
        let Self { url, skin, mut script, encoder, model, line, noise_seed } = self;
        let begin = Instant::now();
        script.start = now_ns();
        let script = Arc::new(script);
        let counters = Arc::new(Counters::default());
        let stop = Arc::new(AtomicBool::new(false));
        let sending = Sending {
            encoder,
            model,
            script: Arc::clone(&script),
            counters: Arc::clone(&counters),
            stop: Arc::clone(&stop),
            line,
            skin: skin.clone(),
            begin,
            requests: 0,
        };
        let worker = Worker::spawn(&skin.name, "virtual-device", stop, move || sending.run(noise_seed))?;
        Ok(VirtualDevice { url, skin, script, counters, worker })
    }
}

/// What the thread of a device works with.
struct Sending {
    encoder: Box<dyn Encoder>,
    model: Arc<dyn ForwardModel>,
    script: Arc<Script>,
    counters: Arc<Counters>,
    stop: Arc<AtomicBool>,
    line: Line,
    skin: SkinDescription,
    begin: Instant,
    /// Frames that the host requested and has not got.
    requests: usize,
}

impl Sending {
    /// Sends a frame each period, or one for each request, until the device is stopped.
    fn run(mut self, noise_seed: u64) -> Result<(), TestbedError> {
        let model = Arc::clone(&self.model);
        let skin = self.skin.clone();
        let mut sampler = Sampler::new(model.as_ref(), &skin, noise_seed)?;
        let mut frame = Frame::new(0, 0, Vec::new());
        let mut index = 0u64;
        loop {
            let t = index as f64 / skin.rate;
            self.wait(t)?;
            if self.stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            if self.encoder.on_request() && self.requests == 0 {
                index += 1;
                continue;
            }
            let late = self.begin.elapsed().as_secs_f64() - t;
            if late > LATE {
                let missed = (late * skin.rate) as u64;
                self.counters.skipped.fetch_add(missed, Ordering::Relaxed);
                index += missed.max(1);
                continue;
            }
            let mut moment = self.script.at(t)?.unwrap_or_default();
            sampler
                .sample(t, &mut moment.stimulus, &mut frame)
                .map_err(|source| TestbedError::Model { press: moment.press, source })?;
            self.send(&mut frame, index, t)?;
            index += 1;
        }
    }

    /// Waits until a frame is due `t` \[s\] after the start; meanwhile requests of the host are read and the line sends on.
    fn wait(&mut self, t: f64) -> Result<(), TestbedError> {
        let due = self.begin + Duration::from_secs_f64(t);
        loop {
            self.requests += self.encoder.requested_frames(&self.line.received());
            // A picture is longer than what a line takes at once.
            self.line.flush().map_err(|source| self.lost(source))?;
            let on_request = self.encoder.on_request();
            if !on_request || self.stop.load(Ordering::Relaxed) || Instant::now() >= due {
                sleep_until(due, &self.stop);
                return Ok(());
            }
            sleep_until(due.min(Instant::now() + Duration::from_secs_f64(LISTEN)), &self.stop);
        }
    }

    fn send(&mut self, frame: &mut Frame, index: u64, t: f64) -> Result<(), TestbedError> {
        // A device that sends on request numbers its answers.
        frame.sequence = if self.encoder.on_request() {
            self.requests -= 1;
            self.counters.frames.load(Ordering::Relaxed)
        } else {
            index
        };
        // Device time 0 would mean that there is no clock.
        let bytes = self
            .encoder
            .encode(frame, 1 + (t * 1e6).round() as u64)
            .map_err(|reason| TestbedError::Wire { skin: self.skin.name.clone(), reason })?;
        let sent = self.line.send(bytes);
        let taken = sent.map_err(|source| self.lost(source))?;
        self.counters.frames.fetch_add(1, Ordering::Relaxed);
        self.counters.dropped.fetch_add(u64::from(!taken), Ordering::Relaxed);
        Ok(())
    }

    fn lost(&self, source: std::io::Error) -> TestbedError {
        TestbedError::Device { skin: self.skin.name.clone(), what: "lost its line", source }
    }
}

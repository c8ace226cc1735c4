//! The working thread of a node: from the bytes of the source to published messages.
//!
//! While the node is active, one turn of the loop takes what the source has, decodes it, estimates the contacts of one frame
//! and publishes them. A frame that waited longer than [`LATE`] gives way to the newest one: it goes through conditioning, so
//! that the zero and the history of the models see every frame, but its contacts are not estimated. While nothing comes, the
//! node says why. A search for contacts on a forward model takes longer than frames come: with a live source it runs in the background, and frames in
//! the meantime are answered without it. While nobody listens to what is estimated, contacts are looked for in a frame of each
//! [`UNHEARD_PERIOD`] only: the zero follows drift where nothing touches, and whoever subscribes finds an estimator that knows the present.

use std::collections::VecDeque;
use std::sync::MutexGuard;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use dermis_msgs::msg::ContactArray;
use dermis_sensor::DecoderOptions;
use dermis_skin::{Estimate, Estimator, Frame};
use dermis_transport::{Event, Source, SourceOptions, SourceUrl, now_ns};

use super::kept_zero;
use super::publishers::KEPT_MAPS;
use super::shared::{Core, Shared, TICK};
use crate::messages::blind_message;

/// How long a frame may wait before it is dropped for the newest one: a time, and a number of periods of the skin; the longer
/// of the two counts. A backlog that takes less than this to work off is worked off.
const LATE: (Duration, f64) = (Duration::from_millis(25), 2.0);
/// Events that are taken from a source in a row, before a frame is processed.
const MOST_EVENTS: usize = 1024;
/// Weight of the last frame in the average of the time that a frame takes.
const PACE: f64 = 0.1;
/// Period of estimates that nobody listens to.
const UNHEARD_PERIOD: Duration = Duration::from_millis(100);
/// Period of the messages of a blind skin.
const BLIND_PERIOD: Duration = Duration::from_millis(500);
/// Shortest time between two warnings about a clock: a broken one jumps with every frame.
const JUMP_PERIOD: Duration = Duration::from_secs(10);
/// Shortest time between two log lines on one reason that a link is down.
const LINK_PERIOD: Duration = Duration::from_secs(60);
/// Shortest time between two log lines that a link is up.
const UP_PERIOD: Duration = Duration::from_secs(5);

/// What the working thread alone knows.
struct Worker<'a> {
    shared: &'a Shared,
    /// Opened before the node was ready, and not yet taken.
    early: Option<Source>,
    /// A recording waits for its reader: none of its frames is dropped.
    live: bool,
    patience: Duration,
    /// Frames that wait, and when they came \[ns since the Unix epoch\].
    waiting: VecDeque<(i64, Frame)>,
    /// \[s\] that a frame takes, on average over the last few.
    pace: f64,
    last_frame: Instant,
    last_blind: Option<Instant>,
    link: LinkLog,
    /// When the zero was written down the last time.
    kept: Option<Instant>,
}

impl Shared {
    /// Reads while the node is active, until it stops.
    pub(super) fn work(&self, early: Option<Source>) {
        let live = !matches!(self.url, SourceUrl::Replay { .. });
        self.lock().estimator.search_in_background(live);
        let worker = Worker {
            shared: self,
            early,
            live,
            patience: LATE.0.max(Duration::from_secs_f64(LATE.1 / self.skin.rate)),
            waiting: VecDeque::new(),
            pace: 0.0,
            last_frame: Instant::now(),
            last_blind: None,
            link: LinkLog::default(),
            kept: None,
        };
        worker.run();
    }
}

/// Asks a device for a frame that sends none by itself, where it is time to.
fn request(core: &mut Core, source: &mut Source) {
    let request = core.decoder.as_mut().and_then(|decoder| decoder.request(now_ns()));
    if let Some(request) = request {
        // Where the link is down it is made again.
        source.send(&request);
    }
}

impl<'a> Worker<'a> {
    fn run(mut self) {
        let mut source: Option<Source> = None;
        while !self.shared.stopping() {
            if !self.shared.active.load(Ordering::Acquire) {
                if source.take().is_some() {
                    self.leave();
                }
                std::thread::sleep(TICK);
                continue;
            }
            if source.is_none() {
                self.enter();
            }
            let source = source.get_or_insert_with(|| {
                let source = self
                    .early
                    .take()
                    .unwrap_or_else(|| Source::open(self.shared.url.clone(), SourceOptions::default()));
                self.shared.lock().source = Some(source.watch());
                source
            });
            self.turn(source);
        }
    }

    /// The node became active.
    fn enter(&mut self) {
        let shared = self.shared;
        let options = DecoderOptions { device_time: shared.device_time };
        let decoder = shared.sensor.decoder(&shared.skin, options);
        let mut core = shared.lock();
        // That there is one was seen before the node was started.
        core.decoder = decoder.ok();
        core.jumps = (0, None);
        drop(core);
        shared.publish_latched();
        self.last_frame = Instant::now();
        self.last_blind = None;
    }

    /// The node is no longer active.
    fn leave(&mut self) {
        self.waiting.clear();
        let mut core = self.shared.lock();
        core.decoder = None;
        core.blind = None;
        self.shared.clear_arrows(&mut core);
    }

    /// Decodes what came, estimates the contacts of one frame, and reports a skin that is blind.
    fn turn(&mut self, source: &mut Source) {
        let shared = self.shared;
        let event = match (self.waiting.is_empty(), self.live) {
            (true, _) => source.next_timeout(TICK),
            (false, true) => source.next_timeout(Duration::ZERO),
            (false, false) => None,
        };
        let mut core = shared.lock();
        core = self.receive(core, source, event);
        // The device works on the next frame while this one is processed.
        request(&mut core, source);
        // Measured before a frame is processed, which may take long: what comes meanwhile is in the queue.
        let silence = self.last_frame.elapsed();
        self.process(&mut core);
        let stale = silence.as_secs_f64() > core.estimator.condition().stale_time;
        if stale || !core.enabled {
            self.say_blind(&mut core, silence);
        }
        if !stale {
            self.keep_zero(&core);
        }
        if core.awaited > 0 {
            shared.progress.notify_all();
        }
    }

    /// Decodes this event and, of a device, those that are there already.
    fn receive(
        &mut self,
        mut core: MutexGuard<'a, Core>,
        source: &mut Source,
        mut event: Option<Event>,
    ) -> MutexGuard<'a, Core> {
        let skin = &self.shared.skin.name;
        let mut taken = 0;
        while let Some(next) = event.take() {
            taken += 1;
            match next {
                Event::Bytes { data, received_ns } => self.decode(&mut core, &data, received_ns),
                Event::Overflow { .. } => core.gap(),
                Event::Disconnected { reason, .. } => {
                    self.link.down(skin, reason);
                    core.gap();
                }
                Event::Connected { description } => self.link.up(skin, &description),
                Event::OtherSender { notice, taken_over } => {
                    tracing::warn!("skin `{skin}`: {notice}");
                    if taken_over {
                        core.gap();
                    }
                }
                Event::Ended => {
                    // Every later event is this one again: the wait is ours.
                    if self.waiting.is_empty() {
                        drop(core);
                        std::thread::sleep(TICK);
                        core = self.shared.lock();
                    }
                    break;
                }
                _ => {}
            }
            if self.live && taken < MOST_EVENTS {
                event = source.next_timeout(Duration::ZERO);
            }
        }
        core
    }

    fn decode(&mut self, core: &mut Core, data: &[u8], received_ns: i64) {
        let mut frames = Vec::new();
        if let Some(decoder) = &mut core.decoder {
            decoder.push(data, received_ns, &mut frames);
        }
        self.shared.warn_of_jumps(core);
        if !frames.is_empty() {
            self.last_frame = Instant::now();
            if core.enabled {
                self.last_blind = None;
                core.blind = None;
            }
        }
        self.waiting.extend(frames.into_iter().map(|frame| (received_ns, frame)));
    }

    /// Estimates the contacts of the frame that waited longest, or of the newest where that one is late.
    fn process(&mut self, core: &mut Core) {
        let Some((received_ns, frame)) = self.waiting.pop_front() else { return };
        let mut newest = frame;
        let waited = u64::try_from(now_ns().saturating_sub(received_ns)).unwrap_or(0);
        let backlog = self.pace * (self.waiting.len() + 1) as f64 > self.patience.as_secs_f64();
        if self.live && backlog && Duration::from_nanos(waited) > self.patience {
            for (_, newer) in self.waiting.drain(..) {
                self.shared.drop_frame(core, std::mem::replace(&mut newest, newer));
            }
        }
        let begun = Instant::now();
        let lately = core.estimated.is_some_and(|at| begun.duration_since(at) < UNHEARD_PERIOD);
        if self.live && lately && !core.publishers.heard() {
            self.shared.pass_unheard(core, newest);
        } else {
            self.shared.estimate(core, newest);
        }
        self.pace += PACE * (begun.elapsed().as_secs_f64() - self.pace);
    }

    /// Publishes why there are no contacts: at once where the reason is new, then every [`BLIND_PERIOD`].
    fn say_blind(&mut self, core: &mut Core, silence: Duration) {
        let shared = self.shared;
        let (status, text) = if core.enabled {
            shared.why_blind(core, silence)
        } else {
            (ContactArray::STATUS_STALE, "switched off by ~/set_enabled".to_owned())
        };
        let news = core.blind.as_ref().is_none_or(|(before, _)| *before != status);
        if news {
            tracing::warn!("skin `{}`: {text}", shared.skin.name);
        }
        if news || self.last_blind.is_none_or(|at| at.elapsed() >= BLIND_PERIOD) {
            self.last_blind = Some(Instant::now());
            let stamp = shared.node.clock().now();
            let c = &*core;
            c.publishers
                .contacts
                .offer(|| Some(blind_message(&shared.skin, &c.estimator, stamp, c.sequence, status, &text)));
            shared.clear_arrows(core);
        }
        core.blind = Some((status, text));
    }

    /// Writes the zero down for a restart, every [`kept_zero::PERIOD`].
    fn keep_zero(&mut self, core: &Core) {
        if self.kept.is_none_or(|at| at.elapsed() >= kept_zero::PERIOD)
            && let Some(save) =
                core.estimator.zero().and_then(|zero| self.shared.kept_zero.save(zero, now_ns()))
        {
            self.kept = Some(Instant::now());
            self.shared.slowly(move || {
                save();
                Ok(())
            });
        }
    }
}

impl Shared {
    /// Warns that stamps begin anew: who differentiates over time takes the jump for a movement.
    fn warn_of_jumps(&self, core: &mut Core) {
        let jumps = core.decoder.as_ref().map_or(0, |decoder| decoder.clock_jumps());
        let (warned, at) = core.jumps;
        if jumps > warned && at.is_none_or(|at| at.elapsed() >= JUMP_PERIOD) {
            core.jumps = (jumps, Some(Instant::now()));
            tracing::warn!(
                "skin `{}`: the device started again, or one of the clocks was set ({jumps} times so far): stamps \
                 follow its clock anew",
                self.skin.name
            );
        }
    }

    /// Why no frame comes, by what link and decoder report.
    fn why_blind(&self, core: &Core, silence: Duration) -> (u8, String) {
        let stats = core.decoder.as_ref().map(|decoder| decoder.stats());
        let name = &self.skin.name;
        if let Some(key) = core.decoder.as_ref().and_then(|decoder| decoder.other_wire()) {
            return (ContactArray::STATUS_FAULT, format!("skin `{name}` on {}: {key}", self.url));
        }
        if let Some(diagnosis) = stats.and_then(|s| s.diagnosis(Some(&self.url))) {
            return (ContactArray::STATUS_FAULT, format!("skin `{name}` on {}: {diagnosis}", self.url));
        }
        let source = core.source();
        let why = if !source.connected {
            source.last_reason.unwrap_or_else(|| format!("{} is not connected yet", self.url))
        } else if stats.is_some_and(|s| s.bytes_since_valid > 0) {
            format!("{} sends bytes, but no whole frame yet", self.url)
        } else {
            format!("{} is connected and silent; check that the device is on", self.url)
        };
        (ContactArray::STATUS_STALE, format!("no frame for {:.1} s: {why}", silence.as_secs_f64()))
    }

    /// Stamps a frame that came, and publishes its picture; returns whether the rest is wanted.
    fn stamp(&self, core: &mut Core, frame: &mut Frame) -> bool {
        core.sequence = frame.sequence;
        // What cannot be offered is tried again with the next picture.
        if frame.image.is_some() && core.publishers.image.is_none() {
            core.publishers.image = self.node.stream_publisher("image", KEPT_MAPS).ok();
        }
        let jpeg = frame.image.as_ref().is_some_and(|image| image.jpeg().is_some());
        if jpeg && core.publishers.jpeg.is_none() {
            core.publishers.jpeg = self.node.stream_publisher("image/compressed", KEPT_MAPS).ok();
        }
        if self.node.clock().is_simulated() {
            frame.stamp = frame.stamp.saturating_sub(now_ns()).saturating_add(self.node.clock().now());
        }
        if let Some(publisher) = &core.publishers.image {
            publisher.offer(|| self.skin.image_message(frame));
        }
        if let Some(publisher) = &core.publishers.jpeg {
            publisher.offer(|| self.skin.compressed_image_message(frame));
        }
        core.enabled
    }

    /// One frame through conditioning only: the contacts are estimated of a newer one.
    fn drop_frame(&self, core: &mut Core, frame: Frame) {
        if self.pass(core, frame) {
            core.figures.dropped += 1;
            core.figures.dropped_total += 1;
        }
    }

    /// One frame through conditioning only: nobody listens to what would be estimated.
    fn pass_unheard(&self, core: &mut Core, frame: Frame) {
        if self.pass(core, frame) {
            core.figures.unheard += 1;
            core.figures.unheard_total += 1;
        }
    }

    /// Conditions a frame, and gives its readings to those who listen to them; whether the node takes frames.
    fn pass(&self, core: &mut Core, mut frame: Frame) -> bool {
        if !self.stamp(core, &mut frame) {
            return false;
        }
        if let Err(error) = core.estimator.pass(&frame) {
            tracing::debug!("skin `{}`: {error}", self.skin.name);
        }
        // A recording of them has every frame.
        let Core { estimator, publishers, figures, .. } = core;
        publishers.taxels.offer(|| Some(self.skin.frame_message(&estimator.conditioned().reading)));
        figures.frames_total += 1;
        figures.frames += 1;
        true
    }

    /// One frame through conditioning, inference and publication.
    fn estimate(&self, core: &mut Core, mut frame: Frame) {
        let begun = Instant::now();
        if !self.stamp(core, &mut frame) {
            return;
        }
        core.estimated = Some(begun);
        let mut wanted = core.publishers.wanted();
        wanted.displacement = wanted.displacement && core.estimator.displacements_ready();
        core.estimator.want_maps(wanted);
        let estimate = core.estimator.estimate(&frame).unwrap_or_else(|error| {
            tracing::debug!("skin `{}`: {error}", self.skin.name);
            Estimate::default()
        });
        self.publish(core, &frame, &estimate);
        let now = self.node.clock().now();
        let figures = &mut core.figures;
        figures.frames_total += 1;
        figures.frames += 1;
        let latency = now.saturating_sub(frame.stamp);
        figures.latency_sum = figures.latency_sum.saturating_add(latency);
        figures.latency_max = figures.latency_max.max(latency);
        let work = i64::try_from(begun.elapsed().as_nanos()).unwrap_or(i64::MAX);
        figures.work_sum = figures.work_sum.saturating_add(work);
        figures.work_max = figures.work_max.max(work);
    }
}

/// Log of a link that may come and go many times a second.
#[derive(Debug, Default)]
struct LinkLog {
    /// Why it was down the last time that this was logged, and when that was.
    reported: Option<(String, Instant)>,
    /// Times that it went down, or was tried, since then.
    unreported: u64,
    up_at: Option<Instant>,
}

impl LinkLog {
    /// A reason is logged once, and again where it is another one or was not logged for long.
    fn down(&mut self, skin: &str, reason: String) {
        let now = Instant::now();
        if self
            .reported
            .as_ref()
            .is_some_and(|(before, at)| *before == reason && now.duration_since(*at) < LINK_PERIOD)
        {
            self.unreported += 1;
            return;
        }
        match std::mem::take(&mut self.unreported) {
            0 => tracing::warn!("skin `{skin}`: {reason}"),
            times => tracing::warn!("skin `{skin}`: {reason} ({times} times more since the last report)"),
        }
        self.reported = Some((reason, now));
    }

    fn up(&mut self, skin: &str, description: &str) {
        let now = Instant::now();
        // One that flaps is not logged each time; one that comes back after a while is.
        if self.up_at.replace(now).is_none_or(|at| now.duration_since(at) >= UP_PERIOD) {
            tracing::info!("skin `{skin}`: connected to {description}");
        }
    }
}

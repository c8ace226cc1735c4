//! The status of a node on `/diagnostics`: what is wrong, and the figures behind it.

use std::sync::atomic::Ordering;
use std::time::Instant;

use dermis_estimate::Quality;
use dermis_msgs::msg::ContactArray;
use dermis_node::{Level, State, Status};
use dermis_skin::{ChannelFlags, TareState};

use super::shared::{Core, Figures, Shared};

/// Share of frames that may be dropped before diagnostics warn of it: any machine is busy elsewhere now and then.
const DROPPED: f64 = 0.01;

impl Shared {
    /// The status now; rates and delays are those since the last call.
    pub(super) fn diagnose(&self) -> Status {
        let mut core = self.lock();
        let active = self.active.load(Ordering::Acquire);
        let mut status = self.state(&core, active);
        let hash = self.skin.hash();
        status.value("skin type", format!("{} ({})", self.skin.type_name(), hash.get(..19).unwrap_or(&hash)));
        let now = Instant::now();
        let reading = active && core.blind.is_none();
        self.rate_and_delays(&mut status, &core.figures, now, reading);
        decoding(&mut status, &core);
        let refused = link(&mut status, &core, active);
        self.channels(&mut status, &core);
        estimation(&mut status, &core);
        status.value("runtime", self.runtime.report());
        status.value("source", &self.url);
        let Figures { frames_total, dropped_total, unheard_total, .. } = core.figures;
        core.refused = refused;
        let since = Some(now);
        core.figures = Figures { frames_total, dropped_total, unheard_total, since, ..Figures::default() };
        status
    }

    /// Whether the node reads, and whether contacts are known.
    fn state(&self, core: &Core, active: bool) -> Status {
        let mut status = Status::ok("reads, and contacts are known");
        if !active {
            let state = self.node.lifecycle().map_or(State::Unconfigured, |life| life.state());
            return Status::ok(format!("{state}: reads nothing"));
        }
        let verdict = core.estimator.verdict();
        if let Some((code, text)) = &core.blind {
            let level = if *code == ContactArray::STATUS_FAULT { Level::Error } else { Level::Stale };
            status.worsen(level, text);
        } else if core.figures.frames_total == 0 {
            status.worsen(Level::Warn, "no frame yet");
        } else {
            match verdict.quality {
                Quality::Ok => {}
                Quality::Degraded | Quality::Uncalibrated => status.worsen(Level::Warn, &verdict.text),
                Quality::Fault => status.worsen(Level::Error, &verdict.text),
            }
        }
        status
    }

    /// Rate, latency and time of processing since the last diagnosis; `reading`: the node is active and not blind.
    fn rate_and_delays(&self, status: &mut Status, figures: &Figures, now: Instant, reading: bool) {
        let elapsed = figures.since.map_or(0.0, |at| now.duration_since(at).as_secs_f64());
        if elapsed > 0.0 {
            let rate = figures.frames as f64 / elapsed;
            status.value("rate [Hz]", format!("{rate:.1}"));
            if reading && rate < 0.5 * self.skin.rate && figures.frames_total > 0 && elapsed > 0.5 {
                status.worsen(
                    Level::Warn,
                    format!("{rate:.1} frames a second where the skin file says {}", self.skin.rate),
                );
            }
        }
        let estimated = figures.frames - figures.dropped - figures.unheard;
        if estimated > 0 {
            let mean = |sum: i64| sum as f64 / estimated as f64 * 1e-6;
            status.value("latency mean [ms]", format!("{:.3}", mean(figures.latency_sum)));
            status.value("latency max [ms]", format!("{:.3}", figures.latency_max as f64 * 1e-6));
            status.value("processing mean [ms]", format!("{:.3}", mean(figures.work_sum)));
            status.value("processing max [ms]", format!("{:.3}", figures.work_max as f64 * 1e-6));
            if reading && figures.dropped as f64 > DROPPED * figures.frames as f64 {
                status.worsen(
                    Level::Warn,
                    format!(
                        "contacts are known for {estimated} of {} frames: estimating them takes {:.1} ms on average and {:.1} ms \
                         at most where a frame comes every {:.1} ms, so that the newest is taken and others are dropped",
                        figures.frames,
                        mean(figures.work_sum),
                        figures.work_max as f64 * 1e-6,
                        1e3 / self.skin.rate
                    ),
                );
            }
        }
        status.value("frames", figures.frames_total);
        status.value("frames dropped", figures.dropped_total);
        status.value("frames nobody listened to", figures.unheard_total);
    }

    /// Names of the channels with each flag.
    fn channels(&self, status: &mut Status, core: &Core) {
        let flags = &core.estimator.conditioned().reading.flags;
        for (name, flag) in [
            ("dead channels", ChannelFlags::DEAD),
            ("saturated channels", ChannelFlags::SATURATED),
            ("stuck channels", ChannelFlags::STUCK),
            ("not finite channels", ChannelFlags::NOT_FINITE),
            ("masked channels", ChannelFlags::MASKED),
        ] {
            let named: Vec<&str> = self
                .skin
                .channels()
                .iter()
                .zip(flags)
                .filter(|(_, f)| f.contains(flag))
                .map(|(c, _)| c.name.as_str())
                .collect();
            status.value(name, if named.is_empty() { "none".into() } else { named.join(", ") });
        }
        if let Some(faults) = core.estimator.element_faults() {
            let sentences: Vec<String> = faults.iter().map(ToString::to_string).collect();
            let none = "none".to_owned();
            status.value("parts out of order", if faults.is_empty() { none } else { sentences.join("; ") });
        }
    }
}

/// What the decoder counted, while there is one.
fn decoding(status: &mut Status, core: &Core) {
    let Some(decoder) = &core.decoder else { return };
    let stats = decoder.stats();
    let rejected = &stats.rejected;
    status.value("frames lost", stats.lost);
    if stats.incomplete > 0 {
        status.value("frames that lacked a part", stats.incomplete);
        status.value("parts lost", stats.lost_parts);
    }
    status.value("CRC errors", rejected.crc);
    status.value("other rejected frames", rejected.total() - rejected.crc);
    status.value("resynchronisations", stats.resyncs);
    status.value("device restarts", stats.restarts);
    status.value("clock jumps", decoder.clock_jumps());
    status.value("stamps from", format!("{:?}", decoder.clock()));
    if let Some(last) = &stats.last_rejection {
        status.value("last rejection", last);
    }
}

/// What the link counted; returns how many datagrams and connections of other senders were refused so far.
fn link(status: &mut Status, core: &Core, active: bool) -> u64 {
    let source = core.source();
    status.value("reconnects", source.connects.saturating_sub(1));
    status.value("disconnects", source.disconnects);
    status.value("bytes dropped", source.dropped_bytes);
    let refused = source.refused_datagrams + source.refused_connections;
    if refused > 0 {
        let others: Vec<String> = source.others.iter().map(ToString::to_string).collect();
        status.value("datagrams of others", source.refused_datagrams);
        status.value("connections refused", source.refused_connections);
        status.value("other senders", others.join(", "));
        if active && refused > core.refused {
            let read = source.peer.map_or_else(|| "another device".to_owned(), |peer| peer.to_string());
            status.worsen(
                Level::Warn,
                format!("{} wants to send too and is left out, while {read} is read", others.join(", ")),
            );
        }
    }
    refused
}

/// Touch, tare and models.
fn estimation(status: &mut Status, core: &Core) {
    let estimator = &core.estimator;
    let verdict = estimator.verdict();
    status.value("level [noise deviations]", format!("{:.2}", verdict.level));
    status.value("touched", verdict.touched);
    if let Some((force, share)) = estimator.undetectable_fraction() {
        status
            .value("undetectable [% of surface]", format!("{:.1} (a press of {force:.2} N)", 100.0 * share));
    }
    status.value(
        "tare",
        match estimator.tare_state() {
            TareState::Done => "done".to_owned(),
            TareState::Averaging { elapsed, .. } => format!("averaging, {elapsed:.1} s so far"),
        },
    );
    let models: Vec<String> =
        estimator.models().map(|(name, path)| format!("{name} ({})", path.display())).collect();
    let models = if core.loading { vec!["being made ready".to_owned()] } else { models };
    status.value("models", if models.is_empty() { "none".into() } else { models.join(", ") });
}

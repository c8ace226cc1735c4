//! Devices that are not there: a model, or a recording, behind a real transport.
//!
//! Both speak the native wire (or lines, where the skin's description says so) on a pseudo-terminal or a TCP
//! port, with sequence and device time, so that a node cannot tell them from hardware.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{JoinHandle, Thread};
use std::time::{Duration, Instant};

use dermis_bag::{BagError, BagReader, BagSkin, SkinChoice, SkinChoiceError, Typed};
use dermis_model::ForwardModel;
use dermis_msgs::msg::{Indentation, TaxelFrame};
use dermis_sensor::{Encoder, FrameWriter};
use dermis_skin::{Frame, SkinDescription, Stamp};
use dermis_transport::{Pty, now_ns};

use crate::{Moment, Plan, Sampler, TestbedError, Timeline};

/// Where a simulated device is plugged in.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Outlet {
    /// A new pseudo-terminal.
    #[default]
    Pty,
    /// A new pseudo-terminal with a symbolic link to it, for a path that stays the same.
    PtyLink(PathBuf),
    /// A TCP server for one client at a time; port 0 takes a free one.
    Tcp(SocketAddr),
}

/// What a simulated device has sent so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeviceStats {
    /// Frames that were made.
    pub frames: u64,
    /// Frames that the line did not take: nobody was reading.
    pub dropped: u64,
    /// Frames that were not made because this process had no time to.
    pub skipped: u64,
}

#[derive(Debug, Default)]
struct Counters {
    frames: AtomicU64,
    dropped: AtomicU64,
    skipped: AtomicU64,
}

impl Counters {
    fn read(&self) -> DeviceStats {
        let get = |c: &AtomicU64| c.load(Ordering::Relaxed);
        DeviceStats { frames: get(&self.frames), dropped: get(&self.dropped), skipped: get(&self.skipped) }
    }
}

/// Where bytes leave the process.
#[derive(Debug)]
enum Port {
    Pty(Pty),
    Tcp { listener: TcpListener, client: Option<TcpStream> },
}

/// The device's end of the line. Like a UART with a buffer, it sends a frame whole or not at all.
#[derive(Debug)]
struct Line {
    port: Port,
    /// The rest of a frame that was begun.
    pending: Vec<u8>,
}

impl Line {
    fn open(outlet: &Outlet, skin: &str) -> Result<(Self, String), TestbedError> {
        let (port, url) = match outlet {
            Outlet::Pty => {
                let pty = Pty::open()?;
                let url = format!("pty://{}", pty.slave_path().display());
                (Port::Pty(pty), url)
            }
            Outlet::PtyLink(link) => {
                let mut pty = Pty::open()?;
                pty.link(link)?;
                (Port::Pty(pty), format!("pty://{}", link.display()))
            }
            Outlet::Tcp(address) => {
                let failed = |source| TestbedError::Device {
                    skin: skin.to_owned(),
                    what: "cannot listen on its TCP port",
                    source,
                };
                let listener = TcpListener::bind(address).map_err(failed)?;
                listener.set_nonblocking(true).map_err(failed)?;
                let bound = listener.local_addr().map_err(failed)?;
                (Port::Tcp { listener, client: None }, format!("tcp://{bound}"))
            }
        };
        Ok((Self { port, pending: Vec::new() }, url))
    }

    /// Takes a frame, and sends of it what the line takes now; `false` where the line is full and the frame is
    /// dropped.
    fn send(&mut self, frame: &[u8]) -> io::Result<bool> {
        if !self.flush()? {
            return Ok(false);
        }
        let Some(sent) = self.write(frame)? else { return Ok(false) };
        if sent == 0 {
            return Ok(false);
        }
        self.pending.extend_from_slice(&frame[sent..]);
        Ok(true)
    }

    /// Sends on what was begun; whether nothing is left of it.
    fn flush(&mut self) -> io::Result<bool> {
        if !self.pending.is_empty() {
            let pending = std::mem::take(&mut self.pending);
            if let Some(sent) = self.write(&pending)? {
                // The client that the frame was begun for may be another by now.
                self.pending = pending[sent..].to_vec();
            }
        }
        Ok(self.pending.is_empty())
    }

    /// What the host wrote, as far as it has come.
    fn heard(&mut self) -> Vec<u8> {
        let mut buffer = [0; 4096];
        let read = match &mut self.port {
            Port::Pty(pty) => pty.try_read(&mut buffer),
            Port::Tcp { client: Some(stream), .. } => stream.read(&mut buffer),
            Port::Tcp { client: None, .. } => return Vec::new(),
        };
        // What is wrong with the line shows when it is written to.
        read.map_or_else(|_| Vec::new(), |n| buffer[..n].to_vec())
    }

    /// What the port takes now; `None` where nobody is there. A TCP client that has gone makes room for another,
    /// which gets whole frames only.
    fn write(&mut self, bytes: &[u8]) -> io::Result<Option<usize>> {
        match &mut self.port {
            Port::Pty(pty) => pty.write_lossy(bytes).map(Some),
            Port::Tcp { listener, client } => {
                if let Ok((stream, _)) = listener.accept() {
                    stream.set_nonblocking(true)?;
                    stream.set_nodelay(true)?;
                    *client = Some(stream);
                    return Ok(None);
                }
                let Some(stream) = client else { return Ok(None) };
                match stream.write(bytes) {
                    Ok(sent) => Ok(Some(sent)),
                    Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => {
                        Ok(Some(0))
                    }
                    Err(_) => {
                        *client = None;
                        Ok(None)
                    }
                }
            }
        }
    }
}

/// The encoder of a skin whose family has no wire of its own.
fn plain_encoder(skin: &SkinDescription) -> Result<Box<dyn Encoder>, TestbedError> {
    FrameWriter::new(skin).map(|writer| Box::new(writer) as Box<dyn Encoder>).ok_or_else(|| {
        TestbedError::Wire {
            skin: skin.name.clone(),
            reason: "is spoken by its sensor family only".to_owned(),
        }
    })
}

/// \[s\] between two looks at what the host asks for.
const LISTEN: f64 = 0.002;

/// How long a replay waits for a full line to be read.
const FULL_LINE: Duration = Duration::from_millis(1);

/// A thread that can be told to end, and is waited for.
#[derive(Debug)]
struct Worker {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<(), TestbedError>>>,
}

impl Worker {
    fn spawn(
        skin: &str,
        name: &str,
        stop: Arc<AtomicBool>,
        body: impl FnOnce() -> Result<(), TestbedError> + Send + 'static,
    ) -> Result<Self, TestbedError> {
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(body).map_err(|source| {
            TestbedError::Device { skin: skin.to_owned(), what: "cannot start its thread", source }
        })?;
        Ok(Self { stop, thread: Some(thread) })
    }

    fn running(&self) -> bool {
        self.thread.as_ref().is_some_and(|t| !t.is_finished())
    }

    fn stop(&mut self) -> Result<(), TestbedError> {
        self.stop.store(true, Ordering::Relaxed);
        let Some(thread) = self.thread.take() else { return Ok(()) };
        Thread::unpark(thread.thread());
        match thread.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.stop.store(true, Ordering::Relaxed);
        } else if let Err(error) = self.stop() {
            tracing::warn!("{error}");
        }
    }
}

/// Sleeps until `deadline`, or less where `stop` is set and the thread unparked.
fn sleep_until(deadline: Instant, stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        let Some(left) = deadline.checked_duration_since(Instant::now()).filter(|d| !d.is_zero()) else {
            return;
        };
        std::thread::park_timeout(left);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What a panicking thread left behind is still a list of timelines.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A plan gone through again and again, with another seed each time.
struct Script {
    plan: Plan,
    model: Arc<dyn ForwardModel>,
    seed: u64,
    start: Stamp,
    rounds: Mutex<Rounds>,
}

/// The last rounds of a script.
struct Rounds {
    /// How many there were.
    count: u64,
    /// Start \[s\] and timeline of each.
    last: VecDeque<(f64, Arc<Timeline>)>,
}

/// Rounds of a plan that a device remembers.
const ROUNDS: usize = 4;

impl Script {
    fn new(plan: Plan, model: Arc<dyn ForwardModel>, seed: u64) -> Result<Self, TestbedError> {
        let first = Arc::new(Timeline::new(&plan, &model, seed)?);
        Ok(Self {
            plan,
            model,
            seed,
            start: 0,
            rounds: Mutex::new(Rounds { count: 1, last: VecDeque::from([(0.0, first)]) }),
        })
    }

    fn first_touch(&self) -> Moment {
        lock(&self.rounds).last.front().map(|(_, timeline)| timeline.first_touch()).unwrap_or_default()
    }

    /// What happens `t` \[s\] after the start; `None` before it, and for what is forgotten.
    fn at(&self, t: f64) -> Result<Option<Moment>, TestbedError> {
        let (begin, timeline) = {
            let mut rounds = lock(&self.rounds);
            while let Some((begin, last)) = rounds.last.back()
                && t >= begin + last.duration()
            {
                let next = begin + last.duration();
                let timeline = Timeline::new(&self.plan, &self.model, self.seed.wrapping_add(rounds.count))?;
                rounds.count += 1;
                rounds.last.push_back((next, Arc::new(timeline)));
                if rounds.last.len() > ROUNDS {
                    rounds.last.pop_front();
                }
            }
            match rounds.last.iter().rev().find(|(begin, _)| *begin <= t) {
                Some((begin, timeline)) => (*begin, Arc::clone(timeline)),
                None => return Ok(None),
            }
        };
        Ok(Some(timeline.at(t - begin)))
    }
}

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
    script: Arc<Script>,
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
        mut encoder: Box<dyn Encoder>,
        model: Arc<dyn ForwardModel>,
        skin: &SkinDescription,
        plan: &Plan,
        seed: u64,
        outlet: &Outlet,
    ) -> Result<Self, TestbedError> {
        let noise_seed = seed ^ 0x5eed_0001;
        // Whether they belong together, before a line is opened.
        drop(Sampler::new(model.as_ref(), skin, noise_seed)?);
        let (mut line, url) = Line::open(outlet, &skin.name)?;
        let mut script = Script::new(plan.clone(), Arc::clone(&model), seed)?;
        // A model may build tables when it is touched for the first time: not while frames are due.
        let warm_up = script.first_touch();
        Sampler::new(model.as_ref(), skin, noise_seed)?
            .warm_up(&warm_up.stimulus)
            .map_err(|source| TestbedError::Model { press: warm_up.press, source })?;
        let begin = Instant::now();
        script.start = now_ns();
        let script = Arc::new(script);
        let counters = Arc::new(Counters::default());
        let stop = Arc::new(AtomicBool::new(false));

        let body = {
            let (script, counters, stop) = (Arc::clone(&script), Arc::clone(&counters), Arc::clone(&stop));
            let (name, rate, skin) = (skin.name.clone(), skin.rate, skin.clone());
            move || {
                let mut sampler = Sampler::new(model.as_ref(), &skin, noise_seed)?;
                let mut frame = Frame::new(0, 0, Vec::new());
                let mut index = 0u64;
                let lost =
                    |source| TestbedError::Device { skin: name.clone(), what: "lost its line", source };
                // Frames that the host asked for and has not got.
                let mut asked = 0;
                loop {
                    let t = index as f64 / rate;
                    loop {
                        asked += encoder.asked(&line.heard());
                        // A picture is longer than what a line takes at once.
                        line.flush().map_err(lost)?;
                        let due = begin + Duration::from_secs_f64(t);
                        if !encoder.on_request() || stop.load(Ordering::Relaxed) || Instant::now() >= due {
                            sleep_until(due, &stop);
                            break;
                        }
                        sleep_until(due.min(Instant::now() + Duration::from_secs_f64(LISTEN)), &stop);
                    }
                    if stop.load(Ordering::Relaxed) {
                        return Ok(());
                    }
                    if encoder.on_request() && asked == 0 {
                        index += 1;
                        continue;
                    }
                    // A device that was stopped for long does not send what it did not measure.
                    let late = begin.elapsed().as_secs_f64() - t;
                    if late > 0.5 {
                        let missed = (late * rate) as u64;
                        counters.skipped.fetch_add(missed, Ordering::Relaxed);
                        index += missed.max(1);
                        continue;
                    }
                    let mut moment = script.at(t)?.unwrap_or_default();
                    sampler
                        .sample(t, &mut moment.stimulus, &mut frame)
                        .map_err(|source| TestbedError::Model { press: moment.press, source })?;
                    // A device that is asked numbers its answers.
                    frame.sequence = if encoder.on_request() {
                        asked -= 1;
                        counters.frames.load(Ordering::Relaxed)
                    } else {
                        index
                    };
                    // Device time 0 would mean that there is no clock.
                    let bytes = encoder
                        .encode(&frame, 1 + (t * 1e6).round() as u64)
                        .map_err(|reason| TestbedError::Wire { skin: name.clone(), reason })?;
                    let taken = line.send(bytes).map_err(lost)?;
                    counters.frames.fetch_add(1, Ordering::Relaxed);
                    counters.dropped.fetch_add(u64::from(!taken), Ordering::Relaxed);
                    index += 1;
                }
            }
        };
        let worker = Worker::spawn(&skin.name, "virtual-device", stop, body)?;
        Ok(Self { url, skin: skin.clone(), script, counters, worker })
    }

    /// Source URL under which a node reads the device.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// What really touched the skin at `stamp`; `None` before the device was started, and for what happened so
    /// long ago that it is forgotten (four rounds of the plan).
    #[must_use]
    pub fn truth(&self, stamp: Stamp) -> Option<Moment> {
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

    /// Whether it is still sending; `false` after its line was lost, and [`stop`](Self::stop) says why.
    #[must_use]
    pub fn running(&self) -> bool {
        self.worker.running()
    }

    /// Pulls the plug: ends the thread, closes the line, and says what had gone wrong before.
    ///
    /// # Errors
    ///
    /// [`TestbedError`] that ended the device before.
    pub fn stop(mut self) -> Result<DeviceStats, TestbedError> {
        self.worker.stop()?;
        Ok(self.stats())
    }
}

/// How a recording is sent.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayOptions {
    /// Factor on the recorded pace; infinite for as fast as it is read.
    pub speed: f64,
    /// Topic of the frames; the only one of that type where absent.
    pub topic: Option<String>,
    /// Name of the skin whose frames are sent; the only one of this type where absent.
    pub instance: Option<String>,
    /// Where the device is plugged in.
    pub outlet: Outlet,
}

impl Default for ReplayOptions {
    fn default() -> Self {
        Self { speed: 1.0, topic: None, instance: None, outlet: Outlet::Pty }
    }
}

/// Why it is not clear which frames of a bag to send.
enum Unclear {
    Bag(BagError),
    Skin(String),
}

impl From<BagError> for Unclear {
    fn from(error: BagError) -> Self {
        Self::Bag(error)
    }
}

/// Topic of the skin whose frames are sent, and the skin: never those of two.
fn choose(
    reader: &BagReader,
    skin: &SkinDescription,
    options: &ReplayOptions,
) -> Result<(String, BagSkin), Unclear> {
    let named = options.topic.as_deref().map(|topic| reader.topic(topic)).transpose()?;
    let named = named.map(|topic| topic.name.as_str());
    let skins = reader.skins()?;
    let choice =
        SkinChoice { instance: options.instance.as_deref(), topic: named, type_name: skin.type_name() };
    let mut chosen = choice.of(&skins, |hash, name| skin.is_type(hash, name));
    // A recording of one skin is taken whatever that is called: its channels are compared below.
    let mut framed = skins.iter().filter(|skin| skin.topics_of::<TaxelFrame>().next().is_some());
    if let (Err(SkinChoiceError::NoneOfType { .. }), Some(only), None) =
        (&chosen, framed.next(), framed.next())
    {
        chosen = Ok(only);
    }
    let chosen = chosen.map_err(|error| {
        Unclear::Skin(format!("{error}; `--skin-instance` names one, `dermis bag info` lists them"))
    })?;
    let topics: Vec<&str> =
        chosen.topics_of::<TaxelFrame>().filter(|topic| named.is_none_or(|named| named == *topic)).collect();
    match topics.as_slice() {
        [only] => Ok(((*only).to_owned(), chosen.clone())),
        [] => Err(Unclear::Skin(format!(
            "has no frames of skin `{}` on {}",
            chosen.name,
            named.unwrap_or_default()
        ))),
        several => Err(Unclear::Skin(format!(
            "frames of skin `{}` come on several topics: {}: two skins would be taken for one",
            chosen.name,
            several.join(", ")
        ))),
    }
}

/// The frames of a bag as a device that sends them once, with the sequence numbers and device times that they
/// were recorded with.
///
/// Nothing is dropped: where the line is full, it waits until somebody reads. The line stays open after the last
/// frame until the device is stopped or dropped. At another speed than 1 the device time keeps its recorded pace
/// and so runs faster or slower than the host's clock.
#[derive(Debug)]
pub struct ReplayDevice {
    url: String,
    counters: Arc<Counters>,
    finished: Arc<AtomicBool>,
    worker: Worker,
}

impl ReplayDevice {
    /// Plugs the recording in and starts to send it.
    ///
    /// # Errors
    ///
    /// [`TestbedError`] where the bag cannot be read, holds no frames of this skin, or there is no line.
    pub fn start(
        bag: impl AsRef<Path>,
        skin: &SkinDescription,
        options: &ReplayOptions,
    ) -> Result<Self, TestbedError> {
        Self::start_on(plain_encoder(skin)?, bag, skin, options)
    }

    /// [`start`](Self::start) with a wire of the sensor family's own.
    ///
    /// # Errors
    ///
    /// As [`start`](Self::start).
    pub fn start_on(
        mut encoder: Box<dyn Encoder>,
        bag: impl AsRef<Path>,
        skin: &SkinDescription,
        options: &ReplayOptions,
    ) -> Result<Self, TestbedError> {
        let path = bag.as_ref().to_path_buf();
        let wrong = |reason: String| TestbedError::Recording { path: path.clone(), reason };
        if options.speed.is_nan() || options.speed <= 0.0 {
            return Err(wrong(format!("replay speed is {} and must be positive", options.speed)));
        }
        let reader = BagReader::open(&path)?;
        let (topic, sender) = choose(&reader, skin, options).map_err(|reason| match reason {
            Unclear::Bag(error) => error.into(),
            Unclear::Skin(reason) => wrong(reason),
        })?;
        // A topic may carry several skins.
        let frames = || {
            let name = sender.name.clone();
            let of_skin = move |message: &Result<Typed<TaxelFrame>, BagError>| {
                message.as_ref().is_ok_and(|typed| typed.message.skin == name) || message.is_err()
            };
            reader.read::<TaxelFrame>(&topic).map(|messages| messages.filter(of_skin))
        };
        let Some(first) = frames()?.next().transpose()?.map(|m| m.message) else {
            return Err(wrong("holds no frames".into()));
        };
        if let Some(reason) = skin.unlike(&first, &sender.layouts) {
            return Err(wrong(format!(
                "its frames are of skin `{}`, and not as `{}` sends them: {reason}",
                first.skin, skin.name
            )));
        }
        let messages = frames()?;
        let (mut line, url) = Line::open(&options.outlet, &skin.name)?;
        let counters = Arc::new(Counters::default());
        let stop = Arc::new(AtomicBool::new(false));
        let finished = Arc::new(AtomicBool::new(false));
        let body = {
            let (counters, stop, finished) =
                (Arc::clone(&counters), Arc::clone(&stop), Arc::clone(&finished));
            let (name, speed, channels) = (skin.name.clone(), options.speed, first.values.len());
            let (begin, zero, layout) = (Instant::now(), first.header.stamp.as_nanos(), first.layout_id);
            move || {
                for message in messages {
                    let frame = message?.message;
                    if frame.layout_id != layout {
                        return Err(TestbedError::Recording {
                            path,
                            reason: format!(
                                "frame {} has the channel layout {:08x} where those before have {layout:08x}: the skin was \
                                 changed in the middle; cut the bag there",
                                frame.sequence, frame.layout_id
                            ),
                        });
                    }
                    if frame.values.len() != channels {
                        return Err(TestbedError::Recording {
                            path,
                            reason: format!(
                                "frame {} has {} values where its channels are {channels}",
                                frame.sequence,
                                frame.values.len()
                            ),
                        });
                    }
                    let since = (frame.header.stamp.as_nanos() - zero).max(0) as f64 * 1e-9 / speed;
                    sleep_until(begin + Duration::from_secs_f64(since), &stop);
                    let bytes = encoder
                        .encode(&Frame::from(&frame), frame.device_time_us)
                        .map_err(|reason| TestbedError::Wire { skin: name.clone(), reason })?;
                    let lost =
                        |source| TestbedError::Device { skin: name.clone(), what: "lost its line", source };
                    while !line.send(bytes).map_err(lost)? {
                        if stop.load(Ordering::Relaxed) {
                            return Ok(());
                        }
                        sleep_until(Instant::now() + FULL_LINE, &stop);
                    }
                    counters.frames.fetch_add(1, Ordering::Relaxed);
                    while !line.flush().map_err(lost)? {
                        if stop.load(Ordering::Relaxed) {
                            return Ok(());
                        }
                        sleep_until(Instant::now() + FULL_LINE, &stop);
                    }
                }
                finished.store(true, Ordering::Release);
                // Hanging up would throw away what is still on its way to the reader.
                while !stop.load(Ordering::Relaxed) {
                    std::thread::park();
                }
                Ok(())
            }
        };
        let worker = Worker::spawn(&skin.name, "replay-device", stop, body)?;
        Ok(Self { url, counters, finished, worker })
    }

    /// Source URL under which a node reads the device.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Whether every frame was handed to the line.
    #[must_use]
    pub fn finished(&self) -> bool {
        self.finished.load(Ordering::Acquire)
    }

    /// Whether it is still plugged in; `false` after it failed, and [`stop`](Self::stop) says why.
    #[must_use]
    pub fn running(&self) -> bool {
        self.worker.running()
    }

    /// What was sent so far.
    #[must_use]
    pub fn stats(&self) -> DeviceStats {
        self.counters.read()
    }

    /// Pulls the plug.
    ///
    /// # Errors
    ///
    /// [`TestbedError`] that ended the replay before.
    pub fn stop(mut self) -> Result<DeviceStats, TestbedError> {
        self.worker.stop()?;
        Ok(self.stats())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{self, Bumps};
    use crate::{CollectOptions, collect};
    use dermis_transport::framing::{DecodedFrame, FrameDecoder, NativeDecoder};
    use dermis_transport::{Event, Source, SourceOptions, SourceUrl};

    const PATIENCE: Duration = Duration::from_secs(20);

    /// Waits until `done` says so.
    fn wait_for(what: &str, mut done: impl FnMut() -> bool) {
        let begin = Instant::now();
        while !done() {
            assert!(begin.elapsed() < PATIENCE, "waited for {what} in vain");
            std::thread::park_timeout(Duration::from_millis(2));
        }
    }

    struct Reader {
        source: Source,
        decoder: NativeDecoder,
        frames: Vec<DecodedFrame>,
    }

    impl Reader {
        fn open(url: &str) -> Self {
            let url = SourceUrl::parse(url).unwrap();
            Self {
                source: Source::open(url, SourceOptions::default()),
                decoder: NativeDecoder::new(Some(3)),
                frames: Vec::new(),
            }
        }

        /// Reads on until there are `count` frames, or `false` where the line goes down.
        fn read(&mut self, count: usize) -> bool {
            let begin = Instant::now();
            while self.frames.len() < count {
                assert!(begin.elapsed() < PATIENCE, "only {} frames came", self.frames.len());
                match self.source.next_timeout(Duration::from_millis(100)) {
                    Some(Event::Bytes { data, received_ns }) => {
                        self.decoder.push(&data, received_ns, &mut self.frames);
                    }
                    Some(Event::Disconnected { .. } | Event::Ended) => return false,
                    _ => {}
                }
            }
            true
        }
    }

    fn check_readings(
        device: &VirtualDevice,
        model: &Arc<dyn ForwardModel>,
        frames: &[DecodedFrame],
        rate: f64,
    ) {
        let mut clean = vec![0.0; 3];
        let mut touched = 0;
        for pair in frames.windows(2) {
            assert_eq!(pair[1].sequence, pair[0].sequence + 1);
        }
        for frame in frames {
            let t = frame.sequence as f64 / rate;
            assert_eq!(frame.device_time_us, Some(1 + (t * 1e6).round() as u64));
            let stamp = device.script.start + (t * 1e9).round() as Stamp;
            let truth = device.truth(stamp).unwrap();
            touched += usize::from(!truth.stimulus.contacts.is_empty());
            model.response(&truth.stimulus, &mut clean).unwrap();
            for (value, clean) in frame.values.iter().zip(&clean) {
                assert!((f64::from(*value) - clean).abs() < 6.0 * 2.0, "{value} for {clean} at {t} s");
            }
        }
        assert!(touched > 5, "only {touched} of {} frames were touched", frames.len());
    }

    #[test]
    fn bytes_decode_to_what_the_model_reads() {
        let skin = testing::skin(500.0);
        let model = Bumps::shared(&skin);
        let device =
            VirtualDevice::start(Arc::clone(&model), &skin, &testing::plan(), 9, &Outlet::Pty).unwrap();
        let mut reader = Reader::open(device.url());
        assert!(reader.read(300));
        check_readings(&device, &model, &reader.frames, 500.0);
        // In real time: 300 frames at 500 Hz took at least as long as they last.
        let (first, last) = (&reader.frames[0], &reader.frames[299]);
        let measured = (last.sequence - first.sequence) as f64 / 500.0;
        assert!(device.script.at(measured).unwrap().is_some());
        assert!(last.received_ns >= device.script.start + (last.sequence as f64 / 500.0 * 1e9) as Stamp);

        let label = device.truth_message(device.script.start + 1_000_000_000).unwrap();
        assert_eq!(label.session, "all-kinds/9");
        assert_eq!(device.truth(device.script.start - 1), None);

        let stats = device.stop().unwrap();
        assert!(stats.frames >= 300);
        // The frames that the line could not take are missing whole.
        assert_eq!(reader.decoder.stats().rejected.total(), 0);
        assert!(!reader.read(usize::MAX), "the line stayed up after the plug was pulled");
    }

    #[test]
    fn rounds_go_on_for_ever_and_differ() {
        let skin = testing::skin(100.0);
        let script = Script::new(testing::plan(), Bumps::shared(&skin), 5).unwrap();
        let length = lock(&script.rounds).last[0].1.duration();
        let first = script.at(0.25).unwrap().unwrap();
        let mut t = 0.25;
        for _ in 0..9 {
            t += length;
            assert!(script.at(t).unwrap().is_some());
        }
        assert_eq!(lock(&script.rounds).last.len(), ROUNDS);
        assert_eq!(script.at(0.25).unwrap(), None, "what is forgotten is not made up");
        let fresh = Script::new(testing::plan(), Bumps::shared(&skin), 5).unwrap();
        assert_eq!(fresh.at(0.25).unwrap().unwrap(), first);
    }

    #[test]
    fn the_truth_holds_what_effects_do_to_what_touches() {
        let skin = testing::skin(100.0);
        let device =
            VirtualDevice::start(Bumps::shared(&skin), &skin, &testing::plan(), 1, &Outlet::Pty).unwrap();
        let (mut still, mut dragged) = (0, 0);
        for i in 0..3000 {
            let moment = device.truth(device.script.start + i64::from(i) * 5_000_000).unwrap();
            for contact in &moment.stimulus.contacts {
                let along = contact.force.x.hypot(contact.force.y);
                if moment.phase == crate::Phase::Hold {
                    assert_eq!(along, 0.0);
                    still += 1;
                } else if (along - 0.05).abs() < 1e-12 {
                    assert!(moment.phase == crate::Phase::Slide || moment.phase == crate::Phase::Unload);
                    dragged += 1;
                }
            }
        }
        assert!(still > 50 && dragged > 10, "{still} still, {dragged} dragged");
        device.stop().unwrap();
    }

    #[test]
    fn nobody_has_to_read() {
        let skin = testing::skin(2000.0);
        let device =
            VirtualDevice::start(Bumps::shared(&skin), &skin, &testing::plan(), 1, &Outlet::Pty).unwrap();
        wait_for("a full line", || device.stats().dropped > 10);
        assert!(device.running());
        drop(device);
    }

    #[test]
    fn tcp_serves_one_client_after_another() {
        let skin = testing::skin(500.0);
        let model = Bumps::shared(&skin);
        let outlet = Outlet::Tcp("127.0.0.1:0".parse().unwrap());
        let device = VirtualDevice::start(Arc::clone(&model), &skin, &testing::plan(), 2, &outlet).unwrap();
        for _ in 0..2 {
            let mut reader = Reader::open(device.url());
            assert!(reader.read(150));
            check_readings(&device, &model, &reader.frames, 500.0);
        }
    }

    #[test]
    fn a_link_comes_and_goes_with_the_device() {
        let dir = tempfile::tempdir().unwrap();
        let link = dir.path().join("pad");
        let skin = testing::skin(100.0);
        let outlet = Outlet::PtyLink(link.clone());
        let device = VirtualDevice::start(Bumps::shared(&skin), &skin, &testing::plan(), 1, &outlet).unwrap();
        assert_eq!(device.url(), format!("pty://{}", link.display()));
        assert!(Reader::open(device.url()).read(5));
        device.stop().unwrap();
        assert!(!link.exists() && std::fs::symlink_metadata(&link).is_err());
    }

    #[test]
    fn raw_counts_are_what_the_description_says() {
        let mut skin = testing::skin(100.0);
        (skin.wire.scale, skin.wire.offset) = (0.25, 100.0);
        let frame = |sequence: u64, values: [f32; 3]| Frame::new(0, sequence, values.to_vec());
        let encode = |skin: &SkinDescription, frame: Frame| {
            plain_encoder(skin).unwrap().encode(&frame, 8).unwrap().to_vec()
        };
        let mut decoded = Vec::new();
        NativeDecoder::new(Some(3)).push(&encode(&skin, frame(7, [100.0, 101.0, f32::NAN])), 0, &mut decoded);
        assert_eq!(decoded[0].values[..2], [0.0, 4.0]);
        assert!(decoded[0].values[2].is_nan());
        skin.wire.protocol = dermis_skin::WireProtocol::Ascii;
        assert_eq!(encode(&skin, frame(7, [100.0, 101.0, 99.5])), b"0,4,-2\n");
        skin.wire.counts = Some([0, 3]);
        assert_eq!(encode(&skin, frame(7, [99.99, 100.6, 101.0])), b"0,2,3\n");
    }

    #[test]
    fn a_recording_is_sent_bit_by_bit() {
        let dir = tempfile::tempdir().unwrap();
        let bag = dir.path().join("bag");
        let skin = testing::skin(200.0);
        let report =
            collect(&Bumps::shared(&skin), &skin, &testing::plan(), &bag, &CollectOptions::default())
                .unwrap();
        let options = ReplayOptions { speed: f64::INFINITY, ..ReplayOptions::default() };
        let device = ReplayDevice::start(&bag, &skin, &options).unwrap();
        let mut reader = Reader::open(device.url());
        assert!(reader.read(report.frames as usize));
        wait_for("the end of the recording", || device.finished());
        let recorded = BagReader::open(&bag).unwrap();
        for (sent, frame) in recorded.read::<TaxelFrame>("taxels").unwrap().zip(&reader.frames) {
            let sent = sent.unwrap().message;
            assert_eq!((sent.sequence, sent.device_time_us), (frame.sequence, frame.device_time_us.unwrap()));
            assert!(sent.values.iter().zip(&frame.values).all(|(a, b)| a.to_bits() == b.to_bits()));
        }
        assert_eq!(device.stop().unwrap().frames, report.frames);
    }

    #[test]
    fn a_recording_keeps_its_pace() {
        let dir = tempfile::tempdir().unwrap();
        let bag = dir.path().join("bag");
        let skin = testing::skin(100.0);
        let plan = testing::PLAN.split("[[steps]]").take(2).collect::<Vec<_>>().join("[[steps]]");
        let plan = Plan::from_toml(&plan, "idle.toml").unwrap();
        collect(&Bumps::shared(&skin), &skin, &plan, &bag, &CollectOptions::default()).unwrap();
        let begin = Instant::now();
        let device =
            ReplayDevice::start(&bag, &skin, &ReplayOptions { speed: 0.5, ..ReplayOptions::default() })
                .unwrap();
        wait_for("the end of the recording", || device.finished());
        // 20 frames of 10 ms: the last is due 190 ms after the first, at half the pace after 380 ms.
        assert!(begin.elapsed() >= Duration::from_millis(380));
    }

    #[test]
    fn a_replay_that_nobody_reads_can_be_stopped() {
        let dir = tempfile::tempdir().unwrap();
        let bag = dir.path().join("bag");
        let skin = testing::skin(200.0);
        collect(&Bumps::shared(&skin), &skin, &testing::plan(), &bag, &CollectOptions::default()).unwrap();
        let options = ReplayOptions { speed: f64::INFINITY, ..ReplayOptions::default() };
        let device = ReplayDevice::start(&bag, &skin, &options).unwrap();
        let mut sent = 0;
        wait_for("a full line", || std::mem::replace(&mut sent, device.stats().frames) == sent && sent > 10);
        assert!(!device.finished());
        device.stop().unwrap();
    }

    #[test]
    fn recordings_of_other_skins_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let bag = dir.path().join("bag");
        let skin = testing::skin(200.0);
        collect(&Bumps::shared(&skin), &skin, &testing::plan(), &bag, &CollectOptions::default()).unwrap();
        let text = r#"
            schema = "dermis-skin/1"
            name = "other"
            sensor = "bumps"
            frame_id = "other_link"
            unit = "Pa"
            rate = 100.0
            noise = 2.0
            surface = { type = "rectangle", size = [0.03, 0.02], spacing = 0.001 }
            taxels = [{ name = "only", position = [0.0, 0.0, -0.005] }]
        "#;
        let other = SkinDescription::from_toml(text, "other.toml").unwrap();
        let refused = |skin: &SkinDescription, options: &ReplayOptions| {
            let error = ReplayDevice::start(&bag, skin, options).unwrap_err().to_string();
            error.replace(&bag.display().to_string(), "BAG")
        };
        insta::assert_snapshot!(refused(&other, &ReplayOptions::default()), @"bag BAG: its frames are of skin `pad`, and not as `other` sends them: frame 0 has 3 values where the skin has 1 channels");
        let still = ReplayOptions { speed: 0.0, ..ReplayOptions::default() };
        insta::assert_snapshot!(refused(&skin, &still), @"bag BAG: replay speed is 0 and must be positive");
    }
}

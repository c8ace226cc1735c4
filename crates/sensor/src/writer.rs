//! From frames to bytes: the wires that every family speaks, from the device's side.

use dermis_skin::{Frame, SkinDescription, WireProtocol, WireSamples};
use dermis_transport::framing::{NativeEncoder, NativeFormat};

use crate::Encoder;

/// Writes frames as a device of the skin does: raw counts, in native frames or as lines of text.
#[derive(Debug)]
pub struct FrameWriter {
    native: Option<NativeEncoder>,
    scale: f64,
    offset: f64,
    counts: Option<[u32; 2]>,
    /// \[bytes\] of a datagram that a longer frame is split for.
    datagram: Option<usize>,
    raw: Vec<f32>,
    /// A line of text, or the parts of a frame.
    line: Vec<u8>,
}

/// Samples of a skin file as the native wire has them.
pub(crate) fn native_format(samples: WireSamples) -> NativeFormat {
    match samples {
        WireSamples::F32 => NativeFormat::F32,
        WireSamples::I16 => NativeFormat::I16,
        WireSamples::U16 => NativeFormat::U16,
        WireSamples::I32 => NativeFormat::I32,
        WireSamples::U12 => NativeFormat::U12,
    }
}

impl FrameWriter {
    /// A writer of the wire that the skin description names; `None` where that is one of its family's own.
    #[must_use]
    pub fn new(skin: &SkinDescription) -> Option<Self> {
        let native = match skin.wire.protocol {
            WireProtocol::Native => {
                Some(NativeEncoder::new(native_format(skin.wire.samples.unwrap_or_default())))
            }
            WireProtocol::Ascii => None,
            WireProtocol::Family(_) => return None,
        };
        Some(Self {
            native,
            scale: skin.wire.scale,
            offset: skin.wire.offset,
            counts: skin.wire.counts,
            datagram: skin.wire.datagram.and_then(|most| usize::try_from(most).ok()),
            raw: Vec::new(),
            line: Vec::new(),
        })
    }
}

impl Encoder for FrameWriter {
    fn encode(&mut self, frame: &Frame, device_time_us: u64) -> Result<&[u8], String> {
        self.raw.clear();
        self.raw.extend(frame.values.iter().map(|v| {
            if let Some([low, high]) = self.counts {
                // A converter gives whole numbers, and no others than it has.
                let count = (f64::from(*v) - self.offset) / self.scale;
                return (count.round().clamp(f64::from(low), f64::from(high)) + 0.0) as f32;
            }
            // Untouched where the device already speaks the skin's unit: a round trip keeps every bit.
            if self.scale == 1.0 && self.offset == 0.0 {
                *v
            } else {
                ((f64::from(*v) - self.offset) / self.scale) as f32
            }
        }));
        // The wire's sequence number wraps at 32 bits.
        let sequence = frame.sequence as u32;
        self.line.clear();
        match (&mut self.native, self.datagram) {
            (Some(native), Some(most)) => {
                let line = &mut self.line;
                native
                    .encode_parts(sequence, device_time_us, &self.raw, most, |part| {
                        line.extend_from_slice(part);
                    })
                    .map_err(|error| error.to_string())?;
                Ok(&self.line)
            }
            (Some(native), None) => {
                native.encode(sequence, device_time_us, &self.raw).map_err(|error| error.to_string())
            }
            (None, _) => {
                for (i, value) in self.raw.iter().enumerate() {
                    let comma = if i == 0 { "" } else { "," };
                    self.line.extend_from_slice(format!("{comma}{value}").as_bytes());
                }
                self.line.push(b'\n');
                Ok(&self.line)
            }
        }
    }
}

//! The reference encoder in C says byte for byte what ours says.

#![expect(clippy::unwrap_used, reason = "a panic in a test is its failure report")]

use std::cell::RefCell;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use dermis_transport::framing::{
    DecodedFrame, FrameDecoder, MAX_CHANNELS, NativeDecoder, NativeEncoder, NativeFormat,
};
use proptest::prelude::*;

fn firmware() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("firmware")
}

/// Compiles with the warnings that firmware authors have on, and with sanitizers where the compiler brings them.
fn compile(out: &Path, sources: &[PathBuf]) {
    let cc = |extra: &[&str]| {
        Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()))
            .args(["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-O2"])
            .args(extra)
            .arg("-I")
            .arg(firmware())
            .arg("-o")
            .arg(out)
            .args(sources)
            .output()
            .expect("a C compiler: Rust links with it, too")
    };
    if cc(&["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]).status.success() {
        return;
    }
    let plain = cc(&[]);
    assert!(plain.status.success(), "{}", String::from_utf8_lossy(&plain.stderr));
}

struct Driver {
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: ChildStdout,
    _folder: tempfile::TempDir,
}

impl Driver {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("driver");
        let driver = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/wire_driver.c");
        compile(&program, &[firmware().join("dermis_wire.c"), driver]);
        let mut child = Command::new(&program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (stdin, stdout) = (child.stdin.take(), child.stdout.take().unwrap());
        Self { child, stdin, stdout, _folder: folder }
    }

    /// A whole frame; `payload` has the values as the C function takes them.
    fn encode(&mut self, format: NativeFormat, sequence: u32, time_us: u64, payload: &[u8]) -> Vec<u8> {
        self.ask(format, sequence, time_us, payload, 0);
        self.answer()
    }

    /// The same in parts for datagrams of so many bytes.
    fn encode_parts(
        &mut self,
        format: NativeFormat,
        sequence: u32,
        payload: &[u8],
        datagram: u32,
    ) -> Vec<Vec<u8>> {
        self.ask(format, sequence, 5, payload, datagram);
        std::iter::from_fn(|| Some(self.answer()).filter(|part| !part.is_empty())).collect()
    }

    fn ask(&mut self, format: NativeFormat, sequence: u32, time_us: u64, payload: &[u8], datagram: u32) {
        let width = if format.bits() == 32 { 4 } else { 2 };
        let channels = u16::try_from(payload.len() / width).unwrap();
        let mut request = vec![format as u8];
        request.extend_from_slice(&channels.to_ne_bytes());
        request.extend_from_slice(&sequence.to_ne_bytes());
        request.extend_from_slice(&time_us.to_ne_bytes());
        request.extend_from_slice(&datagram.to_ne_bytes());
        request.extend_from_slice(payload);
        self.stdin.as_mut().unwrap().write_all(&request).unwrap();
    }

    fn answer(&mut self) -> Vec<u8> {
        let mut len = [0; 4];
        self.stdout.read_exact(&mut len).unwrap();
        let mut frame = vec![0; usize::try_from(u32::from_ne_bytes(len)).unwrap()];
        self.stdout.read_exact(&mut frame).unwrap();
        frame
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        self.stdin = None;
        let _ = self.child.wait();
    }
}

fn values_of(format: NativeFormat, words: &[u32]) -> (Vec<f32>, Vec<u8>) {
    let mut payload = Vec::new();
    let values = words.iter().map(|w| match format {
        NativeFormat::I16 => {
            let v = *w as u16 as i16;
            payload.extend_from_slice(&v.to_ne_bytes());
            f32::from(v)
        }
        NativeFormat::U16 => {
            payload.extend_from_slice(&(*w as u16).to_ne_bytes());
            f32::from(*w as u16)
        }
        NativeFormat::U12 => {
            // Larger counts than there are become the largest.
            let v = (*w as u16) & 0x1fff;
            payload.extend_from_slice(&v.to_ne_bytes());
            f32::from(v.min(0xfff))
        }
        NativeFormat::I32 => {
            // A single-precision number holds 24 bits.
            let v = (*w as i32) >> 8;
            payload.extend_from_slice(&v.to_ne_bytes());
            v as f32
        }
        _ => {
            payload.extend_from_slice(&f32::from_bits(*w).to_ne_bytes());
            f32::from_bits(*w)
        }
    });
    (values.collect(), payload)
}

#[test]
fn c_and_rust_encode_the_same_bytes() {
    let driver = RefCell::new(Driver::start());
    // Zeroes and long runs without one are where stuffing has its corners.
    let word = prop_oneof![3 => any::<u32>(), 2 => Just(0), 2 => Just(0x0101_0101), 1 => Just(0x7fc0_0000)];
    let words = proptest::collection::vec(word, 1..140);
    let format = proptest::sample::select(NativeFormat::ALL.to_vec());
    proptest!(ProptestConfig::with_cases(256), |(format in format, sequence: u32, time: u64, words in words)| {
        let (values, payload) = values_of(format, &words);
        let from_c = driver.borrow_mut().encode(format, sequence, time, &payload);
        let mut encoder = NativeEncoder::new(format);
        prop_assert_eq!(encoder.encode(sequence, time, &values).unwrap(), &from_c[..]);

        let mut frames: Vec<DecodedFrame> = Vec::new();
        let mut decoder = NativeDecoder::new(Some(values.len()));
        decoder.push(&from_c, 5, &mut frames);
        prop_assert_eq!(frames.len(), 1);
        let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(&frames[0].values), bits(&values));
        prop_assert_eq!(frames[0].sequence, u64::from(sequence));
        prop_assert_eq!(frames[0].device_time_us, Some(time).filter(|t| *t != 0));
    });
}

#[test]
fn c_and_rust_split_a_frame_alike() {
    let driver = RefCell::new(Driver::start());
    let words = proptest::collection::vec(any::<u32>(), 1..500);
    let format = proptest::sample::select(NativeFormat::ALL.to_vec());
    proptest!(ProptestConfig::with_cases(64), |(format in format, sequence: u32, words in words, most in 64_u32..600)| {
        let (values, payload) = values_of(format, &words);
        let whole = driver.borrow_mut().encode(format, sequence, 5, &payload);
        let from_c = driver.borrow_mut().encode_parts(format, sequence, &payload, most);
        let mut ours = Vec::new();
        let mut encoder = NativeEncoder::new(format);
        let most = usize::try_from(most).unwrap();
        encoder.encode_parts(sequence, 5, &values, most, |part| ours.push(part.to_vec())).unwrap();
        if whole.len() > most {
            prop_assert_eq!(&ours, &from_c);
        }
        let mut frames: Vec<DecodedFrame> = Vec::new();
        let mut decoder = NativeDecoder::new(Some(values.len()));
        from_c.iter().for_each(|part| decoder.push(part, 5, &mut frames));
        let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(&frames[0].values), bits(&values));
    });
}

#[test]
fn every_block_length_around_254_is_stuffed_alike() {
    let mut driver = Driver::start();
    for channels in (1..=400).chain([MAX_CHANNELS]) {
        // 0x0101 has no zero byte, so that the block grows with the channels.
        let (values, payload) = values_of(NativeFormat::U16, &vec![0x0101; channels]);
        let from_c = driver.encode(NativeFormat::U16, 0x0101_0101, 0x0101_0101_0101_0101, &payload);
        let mut encoder = NativeEncoder::new(NativeFormat::U16);
        let ours = encoder.encode(0x0101_0101, 0x0101_0101_0101_0101, &values).unwrap();
        assert_eq!(ours, from_c, "{channels} channels");
    }
}

#[test]
fn the_example_of_the_document_is_true() {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("WIRE.md")).unwrap();
    let bytes_after = |label: &str| -> Vec<u8> {
        let line = text.lines().find(|l| l.starts_with(&format!("| {label} |"))).expect("the row is there");
        let code = line.split('`').nth(1).expect("the bytes are code");
        code.split(' ').map(|b| u8::from_str_radix(b, 16).unwrap()).collect()
    };
    let mut encoder = NativeEncoder::new(NativeFormat::U16);
    let line = encoder.encode(7, 1_000_000, &[100.0, 0.0, 65535.0]).unwrap();
    assert_eq!(line, bytes_after("on the line"));
    let crc = dermis_transport::framing::CRC_16.checksum(&bytes_after("frame"));
    assert_eq!(crc.to_le_bytes().to_vec(), bytes_after("CRC"));
    assert_eq!(dermis_transport::framing::CRC_16.checksum(b"123456789"), 0x29b1);
}

/// What firmware authors copy: it compiles as C and as C++, and the wide clock survives overflows.
#[test]
fn the_c_clock_extends_32_bits() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("clock.c");
    std::fs::write(
        &source,
        r#"#include "dermis_wire.h"
int main(void) {
    dermis_clock clock = {0, 0};
    uint64_t last = 0, expected = 0;
    int i;
    for (i = 0; i < 20; i++) {
        uint64_t now = dermis_clock_extend(&clock, (uint32_t)expected);
        if (now != expected || (i && now <= last)) return 1;
        last = now;
        expected += 1234567890u;
    }
    return dermis_crc16(0xFFFF, (const uint8_t *)"123456789", 9) == 0x29B1 ? 0 : 2;
}
"#,
    )
    .unwrap();
    let program = folder.path().join("clock");
    compile(&program, &[firmware().join("dermis_wire.c"), source]);
    assert_eq!(Command::new(&program).status().unwrap().code(), Some(0));
}

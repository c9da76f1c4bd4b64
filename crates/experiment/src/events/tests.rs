//! The event file, parsed by an independent reader: a table for the checksum, and fields in their fixed order.

use super::*;
use std::io::Read as _;

/// Computes CRC-32C by table, eight bits at a time, with reflected polynomial.
fn crc32c(bytes: &[u8]) -> u32 {
    let table: Vec<u32> = (0..=255_u8)
        .map(|byte| {
            let mut remainder = u64::from(byte.reverse_bits()) << 32;
            for bit in (32..40).rev() {
                if remainder >> bit & 1 == 1 {
                    remainder ^= 0x1_1edc_6f41 << (bit - 32);
                }
            }
            (remainder as u32).reverse_bits()
        })
        .collect();
    !bytes.iter().fold(u32::MAX, |crc, byte| table[usize::from(crc as u8 ^ byte)] ^ crc >> 8)
}

/// Step and numbers of an event; the version has none.
type EventNumbers = (u64, Vec<(String, f32)>);

/// Reads every event of a whole file.
fn read(path: &Path) -> Vec<EventNumbers> {
    let mut file = std::io::Cursor::new(std::fs::read(path).unwrap());
    let mut take = |n: usize| {
        let mut out = vec![0; n];
        file.read_exact(&mut out).map(|()| out).ok()
    };
    let mut events = Vec::new();
    while let Some(length) = take(8) {
        let checked = |data: &[u8], check: Vec<u8>| {
            let crc = crc32c(data);
            let masked = crc.rotate_right(15).wrapping_add(0xa282_ead8);
            assert_eq!(u32::from_le_bytes(check.try_into().unwrap()), masked);
        };
        checked(&length, take(4).unwrap());
        let data = take(u64::from_le_bytes(length.try_into().unwrap()) as usize).unwrap();
        checked(&data, take(4).unwrap());
        events.push(event(&data));
    }
    events
}

/// A message as a queue of bytes.
struct Message(std::collections::VecDeque<u8>);

impl Message {
    fn byte(&mut self) -> u8 {
        self.0.pop_front().unwrap()
    }
    fn array<const N: usize>(&mut self) -> [u8; N] {
        [(); N].map(|()| self.byte())
    }
    fn encode_varint(&mut self) -> u64 {
        let (mut value, mut shift) = (0, 0);
        loop {
            let byte = self.byte();
            value += u64::from(byte % 128) << shift;
            shift += 7;
            if byte < 128 {
                return value;
            }
        }
    }
    fn inner(&mut self) -> Self {
        let length = self.encode_varint() as usize;
        Self(self.0.drain(..length).collect())
    }
}

/// Parses an event; panics if a field is unexpected.
fn event(data: &[u8]) -> EventNumbers {
    let mut event = Message(data.iter().copied().collect());
    assert_eq!(event.byte(), 0x09, "wall time, double");
    let time = f64::from_le_bytes(event.array());
    assert!(time > 1.7e9 && time < 1e11, "{time} is no time of today");
    let key = event.byte();
    if key == 0x1a {
        assert_eq!(Vec::from(event.inner().0), b"brain.Event:2");
        assert!(event.0.is_empty());
        return (0, vec![]);
    }
    assert_eq!(key, 0x10, "step, varint");
    let step = event.encode_varint();
    assert_eq!(event.byte(), 0x2a, "summary");
    let mut summary = event.inner();
    assert!(event.0.is_empty());
    let mut values = Vec::new();
    while !summary.0.is_empty() {
        assert_eq!(summary.byte(), 0x0a, "value");
        let mut value = summary.inner();
        assert_eq!(value.byte(), 0x0a, "tag");
        let tag = String::from_utf8(value.inner().0.into()).unwrap();
        assert_eq!(value.byte(), 0x15, "simple value, float");
        values.push((tag, f32::from_le_bytes(value.array())));
        assert!(value.0.is_empty());
    }
    (step, values)
}

#[test]
fn checksums_match_rfc_3720() {
    let unmasked = |bytes: &[u8]| u32::from_le_bytes(checksum(bytes)).wrapping_sub(0xa282_ead8).rotate_left(15);
    let rising: Vec<u8> = (0..32).collect();
    let vectors: [(&[u8], u32); 4] =
        [(&[0; 32], 0x8a91_36aa), (&[0xff; 32], 0x62a8_ab43), (&rising, 0x46dd_794e), (b"123456789", 0xe306_9283)];
    for (bytes, crc) in vectors {
        assert_eq!(unmasked(bytes), crc);
        assert_eq!(crc32c(bytes), crc, "the reader of these tests");
    }
}

#[test]
fn event_file_round_trips() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("events");
    std::fs::write(&path, "of an earlier start").unwrap();
    let mut events = Events::create(&path).unwrap();
    let large = u64::from(u32::MAX) * 1000;
    events.push(1, &[("loss", 0.25), ("gaussians", 65_469.0)], 0.0).unwrap();
    events.push(large, &[("a tag longer than 127 bytes ".repeat(9), -1e-3)], 60.0).unwrap();
    events.push::<&str>(large, &[], 0.0).unwrap();
    let expected = [
        (0, vec![]),
        (1, vec![("loss".to_owned(), 0.25), ("gaussians".to_owned(), 65_469.0)]),
        (large, vec![("a tag longer than 127 bytes ".repeat(9), -1e-3)]),
        (large, vec![]),
    ];
    assert_eq!(read(&path), expected);
}

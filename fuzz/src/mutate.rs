//! Mutations of files, as a function of a random stream.
//!
//! Most mutations ignore the format. Three formats have checks that would reject blind changes: checksums of PNG files
//! and archives are corrected afterwards, and so is the header length of safetensors files.

use pwrfgs_core::rng::{Rng, below};
use std::io::{Cursor, Read as _, Write as _};
use zip::{ZipArchive, ZipWriter, write::SimpleFileOptions};

/// Format of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Text, or binary without checksums.
    Plain,
    /// PNG: chunks with checksums.
    Png,
    /// JPEG: ends with a marker.
    Jpeg,
    /// NPZ: an archive of arrays with checksums.
    Archive,
    /// Safetensors: header length (u64), header (JSON), numbers.
    Tensors,
}

impl Form {
    /// Whether its reader notices that the end is missing.
    pub fn has_end(self) -> bool {
        matches!(self, Self::Png | Self::Jpeg | Self::Archive)
    }
}

/// Largest mutated file, bytes.
const LONGEST: usize = 1 << 20;
/// Replacements of words and numbers.
const TOKENS: &str = "0 -1 1 2 255 256 1e308 -1e308 1e309 1e39 1e-46 1e30 NaN nan inf -inf .inf 0.5 -0 65536 2147483648 \
                      4294967295 9223372036854775807 9223372036854775808 18446744073709551615 18446744073709551616 \
                      99999999999999999999999999 0x10 1e PLTE tRNS fdAT";
/// Characters used in text.
const SIGNS: &[u8] = b"()[]{}<>,:;=\"'`\\/.-+#&*!|%@\n\r\t \0\x1b\x7f\xc3\xff09azNe";
/// Starts of deep nesting.
const OPENING: [&[u8]; 8] = [b"[", b"(", b"{", b"[(", b"- ", b"? ", b"Some(", b"a:("];
/// Limits of number ranges, for binary files.
const WHOLE: [u64; 12] =
    [0, 1, 0x7f, 0x80, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 1 << 40, u64::MAX];
const FLOATS: [f32; 7] = [f32::NAN, f32::INFINITY, f32::MAX, f32::MIN, f32::MIN_POSITIVE, 1e30, -1e10];

/// Mutates `seed` by one to four changes, usually one. `other` provides parts.
pub fn mutate(seed: &[u8], other: &[u8], form: Form, rng: &mut Rng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..[1, 1, 1, 2, 2, 4][below(rng, 6)] {
        let guarded = match (form, below(rng, 4)) {
            (Form::Png, 0..=2) => mutate_png(&bytes, rng),
            (Form::Tensors, 0..=2) => mutate_tensors(&bytes, rng),
            (Form::Archive, 0..=1) => mutate_archive(&bytes, rng),
            (Form::Archive | Form::Jpeg, 2) => Some(bytes[..below(rng, bytes.len() + 1)].to_vec()),
            _ => None,
        };
        bytes = guarded.unwrap_or_else(|| blind(&bytes, other, rng));
        bytes.truncate(LONGEST);
    }
    bytes
}

/// Change that ignores the format.
fn blind(bytes: &[u8], other: &[u8], rng: &mut Rng) -> Vec<u8> {
    let is_word = |byte: u8| byte.is_ascii_alphanumeric() || b"+-._".contains(&byte);
    let (kind, mut place, lent) = (below(rng, 16), chunk(bytes.len(), rng), chunk(other.len(), rng));
    let new = match kind {
        0 if place.0 < bytes.len() => {
            place.1 = place.0 + 1;
            vec![bytes[place.0] ^ (1 << below(rng, 8))]
        }
        0 | 1 => Vec::new(),
        2 => {
            place.1 = bytes.len();
            other[lent.0..].to_vec()
        }
        3 => other[lent.0..lent.1].to_vec(),
        4 => bytes[place.0..place.1].repeat([2, 2, 3, 50][below(rng, 4)]),
        5 => vec![SIGNS[below(rng, SIGNS.len())]],
        6 => OPENING[below(rng, OPENING.len())].repeat([8, 200, 5_000, 100_000][below(rng, 4)]),
        7 | 8 => {
            let mut value = match below(rng, 3) {
                0 => FLOATS[below(rng, FLOATS.len())].to_le_bytes().to_vec(),
                1 => f64::from(FLOATS[below(rng, FLOATS.len())]).to_le_bytes().to_vec(),
                _ => WHOLE[below(rng, WHOLE.len())].to_le_bytes()[..1 << below(rng, 4)].to_vec(),
            };
            if below(rng, 2) == 0 {
                value.reverse();
            }
            // Numbers are usually at multiples of their length.
            place.0 = if below(rng, 4) == 0 { place.0 } else { place.0 / value.len() * value.len() };
            place.1 = (place.0 + value.len()).min(bytes.len());
            value
        }
        // A line or a word is replaced, removed or repeated.
        _ => {
            let all = if kind == 9 { runs(bytes, |byte| byte != b'\n') } else { runs(bytes, is_word) };
            if all.is_empty() {
                return bytes.to_vec();
            }
            place = all[below(rng, all.len())];
            let (from, to) = all[below(rng, all.len())];
            let tokens: Vec<&str> = TOKENS.split(' ').collect();
            match below(rng, 8) {
                0 => Vec::new(),
                1 => bytes[place.0..place.1].repeat(2),
                2..5 => bytes[from..to].to_vec(),
                _ => tokens[below(rng, tokens.len())].into(),
            }
        }
    };
    [&bytes[..place.0], &new, &bytes[place.1..]].concat()
}

/// Random chunk of `length` bytes; short ones are more frequent.
fn chunk(length: usize, rng: &mut Rng) -> (usize, usize) {
    let from = below(rng, length + 1);
    let longest = [4, 16, 256, length][below(rng, 4)].min(length - from);
    (from, from + below(rng, longest + 1))
}

/// Longest runs of bytes of one kind.
fn runs(bytes: &[u8], kind: impl Fn(u8) -> bool) -> Vec<(usize, usize)> {
    let ends = bytes.chunk_by(|a, b| kind(*a) == kind(*b)).scan(0, |end, run| {
        *end += run.len();
        Some((*end - run.len(), *end))
    });
    ends.filter(|(from, _)| kind(bytes[*from])).collect()
}

/// Changes or repeats one chunk of a PNG file, or exchanges two, and corrects lengths and checksums. `None` for fewer
/// than 8 bytes, or without a complete chunk.
fn mutate_png(bytes: &[u8], rng: &mut Rng) -> Option<Vec<u8>> {
    let (start, mut rest) = bytes.split_at_checked(8)?;
    let mut chunks = Vec::new();
    while let Some((length, tail)) = rest.split_first_chunk::<4>() {
        let Some((named, tail)) = tail.split_at_checked((u32::from_be_bytes(*length) as usize).saturating_add(4))
        else {
            break;
        };
        chunks.push(named.to_vec());
        rest = tail.get(4..).unwrap_or_default();
    }
    let last = chunks.len().checked_sub(1)?;
    // The first chunk contains sizes, depth, colours and interlacing.
    let (a, b) = ([0, below(rng, last + 1)][below(rng, 2)], below(rng, last + 1));
    match below(rng, 8) {
        0 => chunks.swap(a, b),
        1 => chunks.insert(b, chunks[a].clone()),
        2 => chunks[b] = blind(&chunks[b], &[], rng),
        _ => chunks[a] = [&chunks[a][..4], &blind(&chunks[a][4..], &[], rng)].concat(),
    }
    chunks.iter_mut().for_each(|named| named.resize(named.len().max(4), b'x'));
    let whole = |named: Vec<u8>| {
        let mut crc = flate2::Crc::new();
        crc.update(&named);
        [&(named.len() as u32 - 4).to_be_bytes()[..], &named, &crc.sum().to_be_bytes()].concat()
    };
    Some([start.to_vec(), chunks.into_iter().flat_map(whole).collect()].concat())
}

/// Changes one array of an archive, and corrects lengths and checksums. `None` if the archive or an array cannot be read.
fn mutate_archive(bytes: &[u8], rng: &mut Rng) -> Option<Vec<u8>> {
    let mut archive = ZipArchive::new(Cursor::new(bytes)).ok()?;
    let changed = below(rng, archive.len().max(1));
    let mut out = ZipWriter::new(Cursor::new(Vec::new()));
    for i in 0..archive.len() {
        let mut array = archive.by_index(i).ok()?;
        let options = SimpleFileOptions::default().compression_method(array.compression());
        out.start_file(array.name().ok()?, options).ok()?;
        let mut content = Vec::new();
        array.read_to_end(&mut content).ok()?;
        out.write_all(&if i == changed { blind(&content, &[], rng) } else { content }).ok()?;
    }
    Some(out.finish().ok()?.into_inner())
}

/// Changes the header of a safetensors file as text, or the data after it, and corrects the header length. `None` if
/// the bytes end before the header does.
fn mutate_tensors(bytes: &[u8], rng: &mut Rng) -> Option<Vec<u8>> {
    let (length, rest) = bytes.split_first_chunk::<8>()?;
    let (header, data) = rest.split_at_checked(u64::from_le_bytes(*length) as usize)?;
    let (mut header, mut data) = (header.to_vec(), data.to_vec());
    // Shapes and offsets of tensors are validated early. The metadata precede them.
    let end = header.windows(3).position(|signs| signs == b"}\"}").unwrap_or(header.len());
    match below(rng, 5) {
        0 => data = blind(&data, &[], rng),
        1 => header = blind(&header, &[], rng),
        _ => header = [&blind(&header[..end], &[], rng), &header[end..]].concat(),
    }
    Some([&(header.len() as u64).to_le_bytes()[..], &header, &data].concat())
}

//! Mutations: a file becomes a broken one, as a function of a random stream.
//!
//! Most know nothing of the format: bits, bytes, chunks, lines, numbers, brackets. Two formats guard themselves, so that
//! blind changes end at the guard: of a PNG the checksums are put right afterwards, of a safetensors file the length of its
//! header.

use pwrfgs_core::rng::{Rng, below};

/// What is known of a format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Text, or binary without a guard.
    Plain,
    /// PNG: chunks with checksums.
    Png,
    /// Safetensors: the header's length (u64), the header (JSON), numbers.
    Tensors,
}

/// Longest file made, bytes.
const LONGEST: usize = 1 << 20;
/// What stands in place of a number.
const NUMBERS: [&str; 30] = [
    "0",
    "-1",
    "1",
    "2",
    "255",
    "256",
    "1e308",
    "-1e308",
    "1e309",
    "1e39",
    "1e-46",
    "1e30",
    "NaN",
    "nan",
    "inf",
    "-inf",
    ".inf",
    "",
    "0.5",
    "-0",
    "65536",
    "2147483648",
    "4294967295",
    "9223372036854775807",
    "9223372036854775808",
    "18446744073709551615",
    "18446744073709551616",
    "99999999999999999999999999",
    "0x10",
    "1e",
];
/// Signs that texts are made of.
const SIGNS: &[u8] = b"()[]{}<>,:;=\"'`\\/.-+#&*!|%@\n\r\t \0\x1b\x7f\xc3\xff09azNe";

/// A file made from `seed`: one to four changes, most often one. `other` lends chunks.
pub fn mutate(seed: &[u8], other: &[u8], form: Form, rng: &mut Rng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..[1, 1, 1, 2, 2, 4][below(rng, 6)] {
        bytes = match (form, below(rng, 4)) {
            (Form::Png, 0..=2) => inside_png(&bytes, rng),
            (Form::Tensors, 0..=2) => inside_tensors(&bytes, rng),
            _ => blind(&bytes, other, rng),
        };
        bytes.truncate(LONGEST);
    }
    bytes
}

/// A change that knows no format.
fn blind(bytes: &[u8], other: &[u8], rng: &mut Rng) -> Vec<u8> {
    let mut out = bytes.to_vec();
    let (from, to) = chunk(bytes.len(), rng);
    match below(rng, 16) {
        0 => flip(&mut out, rng),
        1 => overwrite(&mut out, rng),
        2 => out.truncate(below(rng, bytes.len() + 1)),
        3 => out.splice(to..to, bytes[from..to].repeat([1, 1, 2, 50][below(rng, 4)])).for_each(drop),
        4 => out.splice(from..to, []).for_each(drop),
        5 => {
            let (a, b) = chunk(other.len(), rng);
            out.splice(from..to, other[a..b].iter().copied()).for_each(drop);
        }
        6 => {
            let (a, _) = chunk(other.len(), rng);
            out.splice(from.., other[a..].iter().copied()).for_each(drop);
        }
        7 => {
            let sign = SIGNS[below(rng, SIGNS.len())];
            out.splice(from..from, [sign]).for_each(drop);
        }
        8 => nest(&mut out, rng),
        9 => lines(&mut out, rng),
        10 => words(&mut out, rng),
        _ => number(&mut out, rng),
    }
    out
}

/// A chunk of `length` bytes: short ones more often than long ones.
fn chunk(length: usize, rng: &mut Rng) -> (usize, usize) {
    let from = below(rng, length + 1);
    let longest = [4, 16, 256, length][below(rng, 4)].min(length - from);
    (from, from + below(rng, longest + 1))
}

fn flip(bytes: &mut [u8], rng: &mut Rng) {
    if !bytes.is_empty() {
        bytes[below(rng, bytes.len())] ^= 1 << below(rng, 8);
    }
}

/// One to eight bytes become a number at the end of some range, of either byte order.
fn overwrite(bytes: &mut [u8], rng: &mut Rng) {
    const VALUES: [u64; 12] =
        [0, 1, 0x7f, 0x80, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 1 << 40, u64::MAX];
    const FLOATS: [f32; 7] = [f32::NAN, f32::INFINITY, f32::MAX, f32::MIN, f32::MIN_POSITIVE, 1e30, -1e10];
    let mut value = match below(rng, 3) {
        0 => FLOATS[below(rng, FLOATS.len())].to_le_bytes().to_vec(),
        1 => f64::from(FLOATS[below(rng, FLOATS.len())]).to_le_bytes().to_vec(),
        _ => VALUES[below(rng, VALUES.len())].to_le_bytes()[..1 << below(rng, 4)].to_vec(),
    };
    if below(rng, 2) == 0 {
        value.reverse();
    }
    let at = below(rng, bytes.len() + 1);
    // Numbers most often stand at multiples of their length.
    let at = if below(rng, 4) == 0 { at } else { at / value.len() * value.len() };
    bytes[at..].iter_mut().zip(value).for_each(|(byte, new)| *byte = new);
}

/// Many brackets, as a deep nesting begins.
fn nest(bytes: &mut Vec<u8>, rng: &mut Rng) {
    let (at, _) = chunk(bytes.len(), rng);
    let open = [&b"["[..], b"(", b"{", b"[(", b"- ", b"? ", b"Some(", b"a:("][below(rng, 8)];
    bytes.splice(at..at, open.repeat([8, 200, 5_000, 100_000][below(rng, 4)])).for_each(drop);
}

/// Two lines change places, or one comes twice, or is gone.
fn lines(bytes: &mut Vec<u8>, rng: &mut Rng) {
    let mut all: Vec<&[u8]> = bytes.split_inclusive(|byte| *byte == b'\n').collect();
    if all.is_empty() {
        return;
    }
    let (a, b) = (below(rng, all.len()), below(rng, all.len()));
    match below(rng, 3) {
        0 => all.swap(a, b),
        1 => all.insert(b, all[a]),
        _ => _ = all.remove(a),
    }
    *bytes = all.concat();
}

/// A word takes the place of another.
fn words(bytes: &mut Vec<u8>, rng: &mut Rng) {
    let all = runs(bytes, |byte| byte.is_ascii_alphanumeric() || byte == b'_');
    if !all.is_empty() {
        let [(a, b), (c, d)] = [all[below(rng, all.len())], all[below(rng, all.len())]];
        let word = bytes[c..d].to_vec();
        bytes.splice(a..b, word).for_each(drop);
    }
}

/// A number becomes another.
fn number(bytes: &mut Vec<u8>, rng: &mut Rng) {
    let all = runs(bytes, |byte| byte.is_ascii_digit() || b"+-.eE_".contains(&byte));
    let all: Vec<_> = all.into_iter().filter(|(a, b)| bytes[*a..*b].iter().any(u8::is_ascii_digit)).collect();
    if !all.is_empty() {
        let (a, b) = all[below(rng, all.len())];
        bytes.splice(a..b, NUMBERS[below(rng, NUMBERS.len())].bytes()).for_each(drop);
    }
}

/// The longest runs of bytes that are of a kind.
fn runs(bytes: &[u8], kind: impl Fn(u8) -> bool) -> Vec<(usize, usize)> {
    let mut all = Vec::new();
    let mut at = 0;
    for run in bytes.chunk_by(|a, b| kind(*a) == kind(*b)) {
        if kind(run[0]) {
            all.push((at, at + run.len()));
        }
        at += run.len();
    }
    all
}

/// Changes one chunk, or their order, and puts lengths and checksums right.
fn inside_png(bytes: &[u8], rng: &mut Rng) -> Vec<u8> {
    let (mut chunks, mut rest) = (Vec::new(), bytes.get(8..).unwrap_or_default());
    while let Some((head, tail)) = rest.split_first_chunk::<8>() {
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let Some((data, tail)) = tail.split_at_checked(length) else { break };
        chunks.push((head[4..].to_vec(), data.to_vec()));
        rest = tail.get(4..).unwrap_or_default();
    }
    if chunks.is_empty() {
        return bytes.to_vec();
    }
    let (a, b) = (below(rng, chunks.len()), below(rng, chunks.len()));
    match below(rng, 8) {
        0 => chunks.swap(a, b),
        1 => chunks.insert(b, chunks[a].clone()),
        2 => chunks[a].0 = [*b"PLTE", *b"tRNS", *b"gAMA", *b"acTL", *b"iCCP", *b"fdAT"][below(rng, 6)].to_vec(),
        3 => overwrite(&mut chunks[a].1, rng),
        // Sides, depth, colours and interlacing.
        4 | 5 => overwrite(&mut chunks[0].1, rng),
        _ => flip(&mut chunks[a].1, rng),
    }
    let mut out = bytes[..8].to_vec();
    for (kind, data) in chunks {
        let named = [kind, data].concat();
        out.extend((named.len() as u32 - 4).to_be_bytes());
        out.extend(&named);
        out.extend(crc(&named).to_be_bytes());
    }
    out
}

/// CRC-32 as PNG has it.
fn crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    };
    !bytes.iter().fold(!0, step)
}

/// Changes the header as a text, or a number behind it, and puts the header's length right.
fn inside_tensors(bytes: &[u8], rng: &mut Rng) -> Vec<u8> {
    let Some((length, rest)) = bytes.split_first_chunk::<8>() else { return bytes.to_vec() };
    let Some((header, data)) = rest.split_at_checked(u64::from_le_bytes(*length) as usize) else {
        return bytes.to_vec();
    };
    let (mut header, mut data) = (header.to_vec(), data.to_vec());
    match below(rng, 10) {
        0 | 1 => overwrite(&mut data, rng),
        2 => words(&mut header, rng),
        3 => header = blind(&header, &header, rng),
        // What tensors say of themselves is soon caught: shapes and places.
        4 => number(&mut header, rng),
        _ => {
            let end = header.windows(3).position(|signs| signs == b"}\"}").unwrap_or(header.len());
            let mut note = header[..end].to_vec();
            if below(rng, 4) == 0 {
                words(&mut note, rng);
            } else {
                number(&mut note, rng);
            }
            header.splice(..end, note).for_each(drop);
        }
    }
    [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat()
}

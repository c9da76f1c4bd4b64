//! `spectrum/NNNNN.png` and other images: all of one size, decoded in parallel.

use crate::colormap::Colormap;
use crate::folder::list_numbered_files;
use crate::text::read_bytes;
use image::{
    ColorType, DynamicImage, ExtendedColorType, ImageDecoder, ImageError, ImageFormat, ImageReader, ImageResult,
    Limits, codecs::png::PngDecoder,
};
use pwrfgs_core::{Error, Image, Number, Progress, Result, Spectra};
use rayon::prelude::*;
use std::{
    collections::BTreeMap,
    io::Cursor,
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
};

/// Largest image that is read, pixels: a header may declare more than fits into memory.
const MAX_PIXELS: u64 = 1 << 24;
/// Largest image, in its file and as uncompressed pixels, bytes.
pub(crate) const MAX_BYTES: u64 = 2 * MAX_PIXELS;
/// Largest memory of the decoder for metadata: a compressed colour profile of a megabyte may need gigabytes.
const MAX_BESIDE: u64 = 2 * MAX_PIXELS;
const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";
/// First marker of a JPEG file.
const JPEG: &[u8] = b"\xff\xd8";
/// Second byte of its last marker.
const JPEG_END: u8 = 0xd9;

/// Returns the paths of the images in a folder by id: files named by a number with `.png`; others are ignored. `advice` is
/// the next step if the folder does not exist. Returns an error for the id 0 or a repeated id.
pub(crate) fn list_images(folder: &Path, advice: &str) -> Result<BTreeMap<u32, PathBuf>> {
    let images = list_numbered_files(folder, "png", advice)?;
    match images.get(&0) {
        Some(path) => Err(Error::input(path, "invalid id 0; ids count from 1, so number the images from 00001")),
        None => Ok(images),
    }
}

/// Function that decodes one image.
pub(crate) type Decode<'a> = dyn Fn(&Path) -> Result<GreyImage> + Sync + 'a;

/// Decodes all images in parallel into spectra of 8 bits; the first sets the size. Returns the error of the first bad file
/// in the given order, or an error if there is no file, or if the pixels do not fit into memory.
pub(crate) fn load_spectra(files: &[&Path], decode: &Decode<'_>, progress: Progress<'_>) -> Result<Spectra> {
    let [first, others @ ..] = files else { return Spectra::grey((0, 0), Vec::new()) };
    let GreyImage { width, height, bytes, .. } = decode(first)?;
    let name = first.file_name().unwrap_or_default().to_string_lossy();
    let mut pixels = Vec::new();
    let total = bytes.len().saturating_mul(files.len());
    pixels.try_reserve_exact(total).map_err(|e| {
        let problem = format!("{} images of {width} x {height} pixels do not fit into memory ({e})", files.len());
        Error::input(first, format!("{problem}; `pwrfgs import` makes one array of them, of which memory holds a part"))
    })?;
    pixels.extend(bytes);
    pixels.resize(total, 0);
    let done = AtomicUsize::new(1);
    let decode_like_first = |(out, path): (&mut [u8], &&Path)| {
        let image = decode(path)?;
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, files.len());
        image.check_size(path, (width, height), &name)?;
        out.copy_from_slice(&image.bytes);
        Ok(())
    };
    // Collect all results first, so that the reported error does not depend on the threads.
    let targets = pixels.par_chunks_exact_mut(width * height).skip(1).zip(others);
    let results: Vec<Result<()>> = targets.map(decode_like_first).collect();
    results.into_iter().collect::<Result<()>>()?;
    Spectra::grey((width, height), pixels)
}

/// Accepted bit depths.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Depth {
    /// 8-bit grey only.
    Eight,
    /// 8-bit and 16-bit grey.
    Sixteen,
}

/// Grey image, row-major.
pub(crate) struct GreyImage {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) number: Number,
    /// Pixels, little endian.
    pub(crate) bytes: Vec<u8>,
}

impl GreyImage {
    /// Returns an error if the size differs from that of the image `name`, width and height; `path` is this image.
    pub(crate) fn check_size(&self, path: &Path, (width, height): (usize, usize), name: &str) -> Result<()> {
        let Self { width: w, height: h, .. } = self;
        if (*w, *h) == (width, height) {
            return Ok(());
        }
        let problem = format!("is {w} x {h} pixels, but {name} is {width} x {height}");
        Err(Error::input(path, format!("{problem}; all images must have one size")))
    }
}

/// Decodes a grey PNG image of at most this `depth`, or a PNG or JPEG image in colours of `map`. Returns an error for another
/// format, or a missing, damaged or too large file.
pub(crate) fn decode_grey_png(path: &Path, depth: Depth, map: Option<Colormap>) -> Result<GreyImage> {
    if map.is_some() {
        return decode_luminance(path, "add the image", map);
    }
    let file = read_bytes(path, MAX_BYTES, "add the image")?;
    // A file that is cut short within the signature counts as damaged.
    if !file.starts_with(&SIGNATURE[..SIGNATURE.len().min(file.len()).max(1)]) {
        return Err(Error::input(path, "is not a PNG image; save the spectrum as 8-bit grey PNG"));
    }
    let damaged = |e| damage_error(path, &e);
    let decoder = png_decoder(file).map_err(damaged)?;
    let number = match (decoder.original_color_type(), decoder.color_type()) {
        (ExtendedColorType::L8, ColorType::L8) => Number::U8,
        (ExtendedColorType::L16, ColorType::L16) if depth == Depth::Sixteen => Number::U16,
        (original, _) => {
            decode_luminance(path, "add the image", None)?; // for colours of a map, this error is more specific
            let (kind, needed) =
                (describe_colour(original), if depth == Depth::Sixteen { "8-bit or 16-bit" } else { "8-bit" });
            let problem = format!("is {kind}; a spectrum is {needed} grey with one channel: convert it");
            return Err(Error::input(path, problem));
        }
    };
    let (width, height) = checked_size(path, &decoder)?;
    let mut bytes = vec![0; width * height * number.bytes()];
    decoder.read_image(&mut bytes).map_err(damaged)?;
    if number == Number::U16 {
        // The decoder returns native byte order.
        bytes.as_chunks_mut().0.iter_mut().for_each(|v| *v = u16::from_ne_bytes(*v).to_le_bytes());
    }
    Ok(GreyImage { width, height, number, bytes })
}

/// Reads a PNG or JPEG image. Colours become luminance, 16 bits become 8, and transparency is ignored.
///
/// # Errors
/// The file is missing, has another format or more than 2^24 pixels, is cut short or damaged, or has the colours of a
/// [`Colormap`].
pub fn read_image(path: &Path) -> Result<Image> {
    let GreyImage { width, height, bytes, .. } = decode_luminance(path, "check the path", None)?;
    Ok(Image::from_bytes(width, height, &bytes))
}

/// Decodes a PNG or JPEG image like [`read_image`], or the values of colours of `map`; `advice` is the next step if it does
/// not exist. Returns the errors of [`read_image`], and an error for a grey image or other colours if there is a `map`.
pub(crate) fn decode_luminance(path: &Path, advice: &str, map: Option<Colormap>) -> Result<GreyImage> {
    let file = read_bytes(path, MAX_BYTES, advice)?;
    let is_cut = file.starts_with(JPEG) && !has_end_marker(&file);
    let guessed = ImageReader::new(Cursor::new(file)).with_guessed_format();
    let mut reader = guessed.map_err(|e| Error::read(path, e))?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err(Error::input(path, "is not a PNG or JPEG image; convert it"));
    }
    if is_cut {
        return Err(Error::input(path, "is cut short (it has no end marker); copy it again"));
    }
    reader.limits(decoder_limits());
    let decoder = reader.into_decoder().map_err(|e| damage_error(path, &e))?;
    let (width, height) = checked_size(path, &decoder)?;
    let image = DynamicImage::from_decoder(decoder).map_err(|e| damage_error(path, &e))?;
    let bytes = match (map, image.color().has_color()) {
        (Some(map), true) => map.invert(&image.into_rgb8()).map_err(|problem| Error::input(path, problem))?,
        (Some(map), false) => {
            let problem = format!("is grey, not in colours of {}; remove --colormap or `colormap`", map.name());
            return Err(Error::input(path, problem));
        }
        (None, true) => {
            let image = image.into_rgb8();
            if let Some(map) = Colormap::recognise(&image) {
                let name = map.name();
                let problem = format!("has the colours of the colour map {name}, whose luminance is not the value");
                let advice =
                    format!("save grey images, or give --colormap {name} (`pwrfgs import --spectra`, `pwrfgs init`)");
                return Err(Error::input(path, format!("{problem}; {advice} or `colormap: {map:?}` of `Colmap`")));
            }
            DynamicImage::from(image).into_luma8().into_raw()
        }
        (None, false) => image.into_luma8().into_raw(),
    };
    Ok(GreyImage { width, height, number: Number::U8, bytes })
}

/// Returns whether a JPEG file has its end marker; the decoder fills missing pixels with grey.
fn has_end_marker(file: &[u8]) -> bool {
    // Ignores coded pixels: there, zero or a restart marker follows a byte 0xff.
    let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0 | 0xd0..=0xd7 | 0xff);
    let mut segments = &file[JPEG.len()..];
    while let Some(start) = segments.windows(2).position(is_marker) {
        if segments[start + 1] == JPEG_END {
            return true;
        }
        // Skips the segment of any other marker: metadata may hold a thumbnail with its own end marker.
        let length = segments.get(start + 2..start + 4);
        let length = length.map_or(0, |bytes| usize::from(bytes[0]) << 8 | usize::from(bytes[1]));
        segments = segments.get(start + 2 + length..).unwrap_or_default();
    }
    false
}

/// Returns width and height of an image, or an error if it has more than [`MAX_PIXELS`].
fn checked_size(path: &Path, decoder: &impl ImageDecoder) -> Result<(usize, usize)> {
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        let problem = format!("is {width} x {height} pixels, more than {MAX_PIXELS} in all; make it smaller");
        return Err(Error::input(path, problem));
    }
    Ok((width as usize, height as usize))
}

/// Returns the error for an image that cannot be decoded, with the first line of the message of the decoder.
fn damage_error(path: &Path, e: &ImageError) -> Error {
    let words = e.to_string();
    let first = words.lines().next().unwrap_or_default();
    Error::input(path, format!("is cut short or damaged ({first}); copy it again"))
}

/// Creates a PNG decoder with [`decoder_limits`]; it ignores a larger colour profile. Returns an error for a damaged header.
pub(super) fn png_decoder(file: Vec<u8>) -> ImageResult<PngDecoder<Cursor<Vec<u8>>>> {
    PngDecoder::with_limits(Cursor::new(file), decoder_limits())
}

/// Returns the limits of a decoder: memory of [`MAX_BESIDE`].
fn decoder_limits() -> Limits {
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(MAX_BESIDE);
    limits
}

/// Describes a colour type, such as `8-bit grey`.
fn describe_colour(colour: ExtendedColorType) -> String {
    let bits = colour.bits_per_pixel() / u16::from(colour.channel_count());
    match colour.channel_count() {
        1 => format!("{bits}-bit grey"),
        2 => format!("{bits}-bit grey with transparency"),
        _ => format!("{bits}-bit colour"),
    }
}

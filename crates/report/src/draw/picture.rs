//! Pixels inside an SVG.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};

/// RGBA pixels as a PNG inside a `data:` address.
pub(crate) fn png_data(width: usize, height: usize, rgba: &[u8]) -> String {
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(rgba, width as u32, height as u32, ExtendedColorType::Rgba8)
        .expect("four bytes a pixel can be encoded into memory");
    format!("data:image/png;base64,{}", STANDARD.encode(png))
}

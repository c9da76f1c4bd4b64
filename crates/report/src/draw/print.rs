//! A picture for print: its text as outlines, so that it needs no font, and the same in pixels.

use pwrfgs_core::{Error, Result};
use resvg::tiny_skia::{Color, Pixmap, Transform};
use resvg::usvg::{Indent, Options, Tree, WriteOptions, fontdb};
use std::sync::{Arc, OnceLock};

/// The built-in font.
pub(crate) const FONT: &[u8] = include_bytes!("../../assets/labels.ttf");
/// Its name, as other fonts know it by.
const FAMILY: &str = "DejaVu Sans";
/// Pixels of the PNG for each millimetre: 300 dpi.
const PIXELS_PER_MM: f64 = 300.0 / 25.4;

/// A picture that stands by itself.
#[derive(Clone, Debug)]
pub(crate) struct Print {
    /// SVG without text.
    pub(crate) svg: String,
    /// The same as PNG, on white.
    pub(crate) png: Vec<u8>,
}

/// Prints `svg` at a width of `width_mm`. Ids in it begin with `name`, so that pictures can stand in one page.
///
/// # Errors
/// Where `svg` is none, or has no size.
pub(crate) fn print(name: &str, svg: &str, width_mm: f64) -> Result<Print> {
    let failed = |e: &dyn std::fmt::Display| Error::Config(format!("cannot print the figure `{name}`: {e}"));
    let options = Options { font_family: FAMILY.into(), fontdb: fonts(), ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|e| failed(&e))?;
    let size = tree.size();
    let (width, height) = (f64::from(size.width()), f64::from(size.height()));
    let scale = width_mm * PIXELS_PER_MM / width;
    let mut pixels = Pixmap::new((width * scale).round() as u32, (height * scale).round() as u32)
        .ok_or_else(|| failed(&format!("{width} x {height} is no size")))?;
    pixels.fill(Color::WHITE);
    resvg::render(&tree, Transform::from_scale(scale as f32, scale as f32), &mut pixels.as_mut());
    let written = tree.to_string(&WriteOptions {
        id_prefix: Some(format!("{name}-")),
        coordinates_precision: 2,
        transforms_precision: 6,
        indent: Indent::None,
        ..WriteOptions::default()
    });
    // The writer's root knows pixels alone.
    let inside = written.split_once('>').map_or("", |(_, rest)| rest);
    let height_mm = width_mm * height / width;
    let root = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\" \
         width=\"{width_mm}mm\" height=\"{height_mm:.2}mm\" viewBox=\"0 0 {width} {height}\">"
    );
    Ok(Print { svg: root + inside, png: pixels.encode_png().map_err(|e| failed(&e))? })
}

/// The built-in font under every name that pictures use.
fn fonts() -> Arc<fontdb::Database> {
    static FONTS: OnceLock<Arc<fontdb::Database>> = OnceLock::new();
    let load = || {
        let mut fonts = fontdb::Database::new();
        fonts.load_font_data(FONT.to_vec());
        fonts.set_sans_serif_family(FAMILY);
        Arc::new(fonts)
    };
    FONTS.get_or_init(load).clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_becomes_outlines_and_pixels() {
        let svg = "<svg viewBox=\"0 0 254 127\" xmlns=\"http://www.w3.org/2000/svg\">\
                   <text x=\"10\" y=\"100\" font-size=\"90\" font-family=\"sans-serif\">η −</text></svg>";
        let Print { svg, png } = print("eta", svg, 25.4).unwrap();
        assert!(svg.starts_with("<svg ") && svg.contains("width=\"25.4mm\" height=\"12.70mm\""), "{svg}");
        assert!(svg.contains("<path") && !svg.contains("<text"), "{svg}");
        let picture = image::load_from_memory(&png).unwrap().to_luma8();
        assert_eq!(picture.dimensions(), (300, 150));
        let dark = picture.pixels().filter(|p| p.0[0] < 60).count();
        assert!((300..9_000).contains(&dark), "{dark} dark pixels");
        assert!(print("eta", "no picture", 10.0).unwrap_err().to_string().contains("`eta`"));
    }
}

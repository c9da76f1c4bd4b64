//! Canvas as PNG.

use super::font::outlines;
use super::{Canvas, Colour, Paint, Point, RasterImage, Shape, Step, VectorPath};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};
use tiny_skia as skia;

/// Pixels per millimetre, for 300 dpi.
const PIXELS_PER_MM: f64 = 300.0 / 25.4;

impl Canvas {
    /// Returns the PNG on white, `width_mm` wide at 300 dpi.
    ///
    /// # Panics
    /// If the canvas has no width or height.
    pub fn png(&self, width_mm: f64) -> Vec<u8> {
        let scale = width_mm * PIXELS_PER_MM / self.width;
        let [width, height] = [self.width, self.height].map(|length| (length * scale).round() as u32);
        let mut paper = skia::Pixmap::new(width, height).expect("a canvas has a size");
        paper.fill(skia::Color::WHITE);
        draw_shapes(&mut paper, &self.shapes, skia::Transform::from_scale(scale as f32, scale as f32));
        encode_png(width, height, paper.data())
    }
}

/// Encodes RGBA pixels as PNG.
pub(super) fn encode_png(width: u32, height: u32, rgba: &[u8]) -> Vec<u8> {
    let mut png = Vec::new();
    PngEncoder::new_with_quality(&mut png, CompressionType::Default, FilterType::Adaptive)
        .write_image(rgba, width, height, ExtendedColorType::Rgba8)
        .expect("four bytes a pixel can be encoded into memory");
    png
}

/// Draws shapes on the pixels, bottom first.
fn draw_shapes(paper: &mut skia::Pixmap, shapes: &[Shape], transform: skia::Transform) {
    for shape in shapes {
        match shape {
            Shape::Path(path, paint) => draw_path(paper, to_skia_path(path), paint, transform),
            Shape::Circle([x, y], radius, paint) => {
                let circle = skia::PathBuilder::from_circle(*x as f32, *y as f32, *radius as f32);
                draw_path(paper, circle, paint, transform);
            }
            Shape::Text(text) => {
                let paint = Paint::fill(text.letters.colour);
                draw_path(paper, to_skia_path(&outlines(text)), &paint, transform);
            }
            Shape::RasterImage(at, size, pixels) => draw_pixels(paper, *at, *size, pixels, transform),
            Shape::Group([x, y], scale, shapes) => {
                let inner = transform.pre_translate(*x as f32, *y as f32).pre_scale(*scale as f32, *scale as f32);
                draw_shapes(paper, shapes, inner);
            }
        }
    }
}

/// Converts a path to one of `tiny_skia`; `None` if it has no segment.
fn to_skia_path(path: &VectorPath) -> Option<skia::Path> {
    let mut builder = skia::PathBuilder::new();
    let short = |[x, y]: Point| (x as f32, y as f32);
    for step in &path.0 {
        match step {
            Step::Move(p) => builder.move_to(short(*p).0, short(*p).1),
            Step::Line(p) => builder.line_to(short(*p).0, short(*p).1),
            Step::Quad(c, p) => builder.quad_to(short(*c).0, short(*c).1, short(*p).0, short(*p).1),
            Step::Close => builder.close(),
        }
    }
    builder.finish()
}

/// Fills and strokes a path, if there is one.
fn draw_path(paper: &mut skia::Pixmap, path: Option<skia::Path>, paint: &Paint, transform: skia::Transform) {
    let Some(path) = path else { return };
    if let Some(colour) = paint.fill {
        paper.fill_path(&path, &to_skia_paint(colour), skia::FillRule::Winding, transform, None);
    }
    if let Some(colour) = paint.stroke {
        let dash = paint.dash.iter().map(|length| *length as f32).collect();
        let stroke = skia::Stroke {
            width: paint.width as f32,
            line_cap: if paint.round { skia::LineCap::Round } else { skia::LineCap::Butt },
            line_join: skia::LineJoin::Round,
            dash: skia::StrokeDash::new(dash, 0.0),
            ..skia::Stroke::default()
        };
        paper.stroke_path(&path, &to_skia_paint(colour), &stroke, transform, None);
    }
}

/// Converts a colour to a paint of `tiny_skia`.
fn to_skia_paint(colour: Colour) -> skia::Paint<'static> {
    let mut paint = skia::Paint { anti_alias: true, ..skia::Paint::default() };
    let [r, g, b] = colour.rgb;
    paint.set_color_rgba8(r, g, b, (255.0 * colour.opacity).round() as u8);
    paint
}

/// Draws an image with its upper left corner at `[x, y]`, scaled to `size`.
fn draw_pixels(paper: &mut skia::Pixmap, [x, y]: Point, size: Point, pixels: &RasterImage, transform: skia::Transform) {
    let colours = pixels.rgba.chunks_exact(4).map(|p| skia::ColorU8::from_rgba(p[0], p[1], p[2], p[3]).premultiply());
    let bytes = colours.flat_map(|c| [c.red(), c.green(), c.blue(), c.alpha()]).collect();
    let size_in_pixels = skia::IntSize::from_wh(pixels.width as u32, pixels.height as u32);
    let image = size_in_pixels.and_then(|size| skia::Pixmap::from_vec(bytes, size)).expect("pixels have a size");
    let [across, down] = [size[0] / pixels.width as f64, size[1] / pixels.height as f64];
    let inner = transform.pre_translate(x as f32, y as f32).pre_scale(across as f32, down as f32);
    let quality = if pixels.smooth { skia::FilterQuality::Bilinear } else { skia::FilterQuality::Nearest };
    paper.draw_pixmap(0, 0, image.as_ref(), &skia::PixmapPaint { quality, ..Default::default() }, inner, None);
}

#[cfg(test)]
mod tests {
    use super::super::{Anchor, BLACK, INK, TextStyle};
    use super::*;

    /// Returns the grey values and width of the image.
    fn grey(canvas: &Canvas, width_mm: f64) -> image::GrayImage {
        image::load_from_memory(&canvas.png(width_mm)).unwrap().to_luma8()
    }

    #[test]
    fn png_draws_text_as_outlines() {
        let mut canvas = Canvas::new(254.0, 127.0);
        canvas.letters = TextStyle { size: 90.0, colour: BLACK };
        canvas.text([10.0, 100.0], Anchor::Start, "η − <");
        let svg = canvas.svg_for_print(25.4);
        assert!(svg.starts_with("<svg ") && svg.contains("width=\"25.4mm\" height=\"12.70mm\""), "{svg}");
        assert!(svg.contains("<path") && !svg.contains("<text"), "{svg}");
        let on_page = canvas.svg("chart", "\"a\" & b");
        assert!(on_page.contains(">η − &lt;</text>") && on_page.contains("\"&quot;a&quot; &amp; b\""), "{on_page}");
        let image = grey(&canvas, 25.4);
        assert_eq!(image.dimensions(), (300, 150));
        let dark = image.pixels().filter(|p| p.0[0] < 60).count();
        assert!((300..9_000).contains(&dark), "{dark} dark pixels");
    }

    #[test]
    fn png_draws_every_shape_at_its_position() {
        let mut piece = Canvas::new(10.0, 10.0);
        piece.circle([5.0, 5.0], 5.0, Paint::fill(BLACK));
        let mut canvas = Canvas::new(100.0, 100.0);
        canvas.add_drawing([0.0, 0.0], 2.0, &piece); // to (20, 20)
        canvas.rect([50.0, 0.0], [10.0, 10.0], Paint::fill(INK.with_opacity(0.5)));
        canvas.line(&[[70.0, 5.0], [70.0, 5.0]], Paint { round: true, ..Paint::stroke(BLACK, 8.0) });
        canvas.line(&[[0.0, 50.0], [100.0, 50.0]], Paint { dash: &[10.0, 10.0], ..Paint::stroke(BLACK, 4.0) });
        let chess = RasterImage { width: 2, height: 1, rgba: [[0, 0, 0, 255], [255; 4]].concat(), smooth: false };
        canvas.pixels([60.0, 80.0], [20.0, 20.0], chess);
        let image = grey(&canvas, 100.0 * 25.4 / 300.0);
        let at = |x, y| image.get_pixel(x, y).0[0];
        assert_eq!((at(10, 10), at(18, 18), at(30, 30)), (19, 255, 255), "a circle, scaled");
        assert!((150..180).contains(&at(55, 5)), "half ink on white is {}", at(55, 5));
        assert_eq!((at(70, 5), at(72, 6), at(75, 5)), (19, 19, 255), "a dot");
        assert_eq!((at(5, 50), at(15, 50), at(25, 50)), (19, 255, 19), "dashes");
        assert_eq!((at(65, 90), at(75, 90)), (0, 255), "pixels");
    }
}

//! Canvas as PDF: one page of vectors, text as outlines, images as pixels.
//!
//! Uses the parts of ISO 32000 that shapes need: paths, colours with opacity, images with soft masks. Equal canvases
//! give equal bytes: the file has neither date nor identifier.

use super::font::outlines;
use super::svg::Short;
use super::{Canvas, Colour, Paint, Point, RasterImage, Shape, Step, VectorPath};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::fmt::Write as _;
use std::io::Write as _;

/// Points per millimetre.
const POINTS_PER_MM: f64 = 72.0 / 25.4;
/// Handle length of four curves that form a circle of radius 1.
const HANDLE: f64 = 0.552_284_75;

impl Canvas {
    /// Returns the PDF for print, `width_mm` wide: needs no fonts and stays sharp.
    pub fn pdf(&self, width_mm: f64) -> Vec<u8> {
        let scale = width_mm * POINTS_PER_MM / self.width;
        let [width, height] = [self.width, self.height].map(|length| Short(length * scale));
        let mut page = Page::default();
        // In PDF, y points up from the bottom of the page. `1 j` joins strokes round.
        page.append(format_args!("{scale:.6} 0 0 -{scale:.6} 0 {height} cm 1 j\n"));
        page.draw_shapes(&self.shapes);
        let mut file = File::new();
        file.add_dictionary("<</Type/Catalog/Pages 2 0 R>>");
        file.add_dictionary("<</Type/Pages/Kids[3 0 R]/Count 1>>");
        // Object 3 is the page, object 4 its content; images follow, each after its mask, as `File::add_image` adds them.
        let mut images = String::new();
        let mut next = 5;
        for (k, pixels) in page.images.iter().enumerate() {
            next += usize::from(has_mask(pixels));
            _ = write!(images, "/I{k} {next} 0 R");
            next += 1;
        }
        let states = page
            .opacities
            .iter()
            .enumerate()
            .map(|(k, [fill, stroke])| format!("/A{k}<</ca {}/CA {}>>", Short(*fill), Short(*stroke)));
        let states: String = states.collect();
        file.add_dictionary(&format!(
            "<</Type/Page/Parent 2 0 R/MediaBox[0 0 {width} {height}]/Group<</S/Transparency/CS/DeviceRGB>>\
             /Resources<</ExtGState<<{states}>>/XObject<<{images}>>>>/Contents 4 0 R>>"
        ));
        file.add_stream("", page.out.as_bytes());
        page.images.iter().for_each(|pixels| file.add_image(pixels));
        file.finish()
    }
}

/// Content stream of a page.
#[derive(Default)]
struct Page<'a> {
    out: String,
    /// Paint that was set last.
    paint: Option<Paint>,
    /// Pairs of fill and stroke opacity in use.
    opacities: Vec<[f64; 2]>,
    images: Vec<&'a RasterImage>,
}

impl<'a> Page<'a> {
    /// Appends operators to the content.
    fn append(&mut self, text: std::fmt::Arguments<'_>) {
        self.out.write_fmt(text).expect("text takes all text");
    }

    /// Draws shapes, bottom first.
    fn draw_shapes(&mut self, shapes: &'a [Shape]) {
        for shape in shapes {
            match shape {
                Shape::Path(path, paint) => self.draw_path(path, paint),
                Shape::Circle(middle, radius, paint) => self.draw_circle(*middle, *radius, paint),
                Shape::Text(text) => self.draw_path(&outlines(text), &Paint::fill(text.letters.colour)),
                Shape::RasterImage([x, y], [width, height], pixels) => {
                    let (k, bottom) = (self.images.len(), Short(y + height));
                    let [x, width, height] = [*x, *width, *height].map(Short);
                    self.images.push(pixels);
                    // Images are opaque, whatever the last paint was.
                    let opaque = self.opacity_index([1.0; 2]);
                    self.append(format_args!("q /A{opaque} gs {width} 0 0 -{height} {x} {bottom} cm /I{k} Do Q\n"));
                }
                Shape::Group([x, y], scale, shapes) => {
                    self.append(format_args!("q {scale:.4} 0 0 {scale:.4} {} {} cm\n", Short(*x), Short(*y)));
                    let before = self.paint;
                    self.draw_shapes(shapes);
                    self.paint = before;
                    self.append(format_args!("Q\n"));
                }
            }
        }
    }

    /// Returns the index of a pair of opacities, added at its first use.
    fn opacity_index(&mut self, opacities: [f64; 2]) -> usize {
        self.opacities.iter().position(|pair| *pair == opacities).unwrap_or_else(|| {
            self.opacities.push(opacities);
            self.opacities.len() - 1
        })
    }

    /// Sets colours and strokes if they changed, and returns the painting operator.
    fn set_paint(&mut self, paint: &Paint) -> &'static str {
        if self.paint != Some(*paint) {
            self.paint = Some(*paint);
            let opacity = self.opacity_index([paint.fill, paint.stroke].map(|c| c.map_or(1.0, |c| c.opacity)));
            self.append(format_args!("/A{opacity} gs"));
            for (operator, colour) in [("rg", paint.fill), ("RG", paint.stroke)] {
                let Some(Colour { rgb, .. }) = colour else { continue };
                let [r, g, b] = rgb.map(|part| f64::from(part) / 255.0);
                self.append(format_args!(" {r:.3} {g:.3} {b:.3} {operator}"));
            }
            if paint.stroke.is_some() {
                let dash: Vec<String> = paint.dash.iter().map(f64::to_string).collect();
                let (width, cap) = (Short(paint.width), u8::from(paint.round));
                self.append(format_args!(" {width} w {cap} J [{}] 0 d", dash.join(" ")));
            }
            self.out.push('\n');
        }
        match (paint.fill, paint.stroke) {
            (Some(_), Some(_)) => "B",
            (Some(_), None) => "f",
            (None, Some(_)) => "S",
            (None, None) => "n",
        }
    }

    /// Draws a path.
    fn draw_path(&mut self, path: &VectorPath, paint: &Paint) {
        let operator = self.set_paint(paint);
        let mut last = [0.0; 2];
        for step in &path.0 {
            match *step {
                Step::Move(p) => self.append(format_args!("{} {} m ", Short(p[0]), Short(p[1]))),
                Step::Line(p) => self.append(format_args!("{} {} l ", Short(p[0]), Short(p[1]))),
                // A quadratic curve is a cubic with handles at two thirds.
                Step::Quad(c, p) => {
                    let handle = |end: Point| [0, 1].map(|k| end[k] + (c[k] - end[k]) * 2.0 / 3.0);
                    self.append_curve(handle(last), handle(p), p);
                }
                Step::Close => self.out.push_str("h "),
            }
            let (Step::Move(end) | Step::Line(end) | Step::Quad(_, end)) = *step else { continue };
            last = end;
        }
        self.append(format_args!("{operator}\n"));
    }

    /// Appends a cubic curve with the handles `a` and `b`.
    fn append_curve(&mut self, a: Point, b: Point, end: Point) {
        let [a, b, end] = [a, b, end].map(|p| p.map(Short));
        self.append(format_args!("{} {} {} {} {} {} c ", a[0], a[1], b[0], b[1], end[0], end[1]));
    }

    /// Draws a circle as four curves.
    fn draw_circle(&mut self, [x, y]: Point, radius: f64, paint: &Paint) {
        let operator = self.set_paint(paint);
        let at = |dx: f64, dy: f64| [x + radius * dx, y + radius * dy];
        self.append(format_args!("{} {} m ", Short(x + radius), Short(y)));
        for (dx, dy) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
            let (a, b) = (at(dx - HANDLE * dy, dy + HANDLE * dx), at(HANDLE * dx - dy, HANDLE * dy + dx));
            self.append_curve(a, b, at(-dy, dx));
        }
        self.append(format_args!("h {operator}\n"));
    }
}

/// Returns whether any pixel is partly transparent, so that the image needs a mask.
fn has_mask(pixels: &RasterImage) -> bool {
    pixels.rgba.chunks_exact(4).any(|p| p[3] < 255)
}

/// PDF objects with their offsets.
struct File {
    bytes: Vec<u8>,
    offsets: Vec<usize>,
}

impl File {
    /// Starts a file, with four bytes that mark it as binary.
    fn new() -> Self {
        Self { bytes: b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n".to_vec(), offsets: Vec::new() }
    }

    /// Adds an object with the dictionary `body`.
    fn add_dictionary(&mut self, body: &str) {
        self.add_object(|bytes| bytes.extend_from_slice(body.as_bytes()));
    }

    /// Adds an object with `content` as a compressed stream, and further `entries` of its dictionary.
    fn add_stream(&mut self, entries: &str, content: &[u8]) {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        let packed = encoder.write_all(content).and_then(|()| encoder.finish()).expect("memory takes all bytes");
        self.add_object(|bytes| {
            let head = format!("<<{entries}/Filter/FlateDecode/Length {}>>\nstream\n", packed.len());
            bytes.extend_from_slice(head.as_bytes());
            bytes.extend_from_slice(&packed);
            bytes.extend_from_slice(b"\nendstream");
        });
    }

    /// Adds an object with the content that `write` appends, and records its offset.
    fn add_object(&mut self, write: impl FnOnce(&mut Vec<u8>)) {
        self.offsets.push(self.bytes.len());
        self.bytes.extend_from_slice(format!("{} 0 obj\n", self.offsets.len()).as_bytes());
        write(&mut self.bytes);
        self.bytes.extend_from_slice(b"\nendobj\n");
    }

    /// Adds an image, after its mask if it has one; [`Canvas::pdf`] numbers the objects in this order.
    fn add_image(&mut self, pixels: &RasterImage) {
        let (width, height, smooth) = (pixels.width, pixels.height, pixels.smooth);
        let entries = |colours: &str| {
            format!(
                "/Type/XObject/Subtype/Image/Width {width}/Height {height}/ColorSpace/{colours}/BitsPerComponent 8\
                 /Interpolate {smooth}"
            )
        };
        let mut rgb_entries = entries("DeviceRGB");
        if has_mask(pixels) {
            let alpha: Vec<u8> = pixels.rgba.chunks_exact(4).map(|p| p[3]).collect();
            self.add_stream(&entries("DeviceGray"), &alpha);
            _ = write!(rgb_entries, "/SMask {} 0 R", self.offsets.len());
        }
        let rgb: Vec<u8> = pixels.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        self.add_stream(&rgb_entries, &rgb);
    }

    /// Appends the table of object offsets, and returns the file.
    fn finish(mut self) -> Vec<u8> {
        let (start, count) = (self.bytes.len(), self.offsets.len() + 1);
        let mut table = format!("xref\n0 {count}\n0000000000 65535 f \n");
        for offset in &self.offsets {
            _ = writeln!(table, "{offset:010} 00000 n ");
        }
        _ = writeln!(table, "trailer\n<</Size {count}/Root 1 0 R>>\nstartxref\n{start}\n%%EOF");
        self.bytes.extend_from_slice(table.as_bytes());
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use crate::canvas::{Anchor, BLACK, Canvas, INK, Paint, RasterImage, WHITE};
    use std::io::Read as _;

    /// Returns the position of `expected` in the bytes.
    fn find(bytes: &[u8], expected: &str) -> Option<usize> {
        bytes.windows(expected.len()).position(|part| part == expected.as_bytes())
    }

    /// Checks the table of objects; returns text and decompressed stream of each object.
    fn parsed(pdf: &[u8]) -> Vec<(String, Vec<u8>)> {
        assert!(pdf.starts_with(b"%PDF-1.4\n") && pdf.ends_with(b"%%EOF\n"));
        let table = find(pdf, "\nxref\n").unwrap() + 1;
        let text = std::str::from_utf8(&pdf[table..]).unwrap();
        assert!(text.contains(&format!("startxref\n{table}\n")), "{text}");
        let begins = text.lines().filter(|line| line.ends_with(" 00000 n ")).map(|l| l[..10].parse::<usize>().unwrap());
        let object = |(k, begin): (usize, usize)| {
            let object = &pdf[begin..];
            assert!(object.starts_with(format!("{} 0 obj\n", k + 1).as_bytes()));
            let Some(at) = find(object, "\nstream\n") else {
                return (String::from_utf8_lossy(&object[..find(object, "endobj").unwrap()]).into(), Vec::new());
            };
            let head = String::from_utf8_lossy(&object[..at]).into_owned();
            let length: usize = head.split("/Length ").nth(1).unwrap().trim_end_matches('>').parse().unwrap();
            let packed = &object[at + 8..][..length];
            assert!(object[at + 8 + length..].starts_with(b"\nendstream\nendobj\n"));
            let mut content = Vec::new();
            flate2::read::ZlibDecoder::new(packed).read_to_end(&mut content).unwrap();
            (head, content)
        };
        begins.enumerate().map(object).collect()
    }

    #[test]
    fn pdf_contains_every_shape_and_valid_offsets() {
        let mut piece = Canvas::new(10.0, 10.0);
        piece.circle([5.0, 5.0], 5.0, Paint::fill(BLACK));
        let mut canvas = Canvas::new(100.0, 50.0);
        canvas.add_drawing([10.0, 20.0], 2.0, &piece);
        canvas.text([10.0, 10.0], Anchor::Start, "(η) \\ <");
        canvas.rect([50.0, 0.0], [10.0, 10.0], Paint::fill(INK.with_opacity(0.5)).outlined(WHITE, 2.0));
        canvas.line(&[[0.0, 50.0], [100.0, 50.0]], Paint { dash: &[10.0, 5.0], ..Paint::stroke(BLACK, 4.0) });
        let chess =
            |alpha| RasterImage { width: 2, height: 1, rgba: vec![0, 0, 0, alpha, 9, 8, 7, 255], smooth: false };
        canvas.pixels([60.0, 20.0], [20.0, 20.0], chess(255));
        canvas.pixels([60.0, 20.0], [20.0, 20.0], chess(0));
        let pdf = canvas.pdf(25.4);
        assert_eq!(pdf, canvas.pdf(25.4));
        let objects = parsed(&pdf);
        assert_eq!(objects.len(), 7, "catalogue, pages, page, content, an image, a mask and its image");
        assert!(objects[2].0.contains("/MediaBox[0 0 72 36]") && objects[2].0.contains("/I0 5 0 R/I1 7 0 R"));
        assert!(objects[2].0.contains("/ca 0.5/CA 1"), "{}", objects[2].0);
        assert_eq!((&objects[4].1[..], &objects[5].1[..]), (&[0, 0, 0, 9, 8, 7][..], &[0, 255][..]));
        assert!(objects[6].0.contains("/SMask 6 0 R"));
        let drawn = String::from_utf8(objects[3].1.clone()).unwrap();
        for operator in [" cm", " c ", " l ", " f\n", " B\n", " S\n", "[10 5] 0 d", "/I1 Do", "0 0 -20 60 40 cm"] {
            assert!(drawn.contains(operator), "`{operator}` is not in {drawn}");
        }
        assert_eq!(drawn.matches("q ").count(), drawn.matches("Q\n").count());
        assert!(!drawn.contains("Tj") && !drawn.contains("NaN"));
    }
}

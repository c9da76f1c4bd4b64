//! Canvas as SVG text.

use super::font::outlines;
use super::png::encode_png;
use super::{Anchor, Canvas, Colour, Paint, Point, RasterImage, Shape, Step, Text, VectorPath};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use pwrfgs_core::messages;
use std::fmt::Write as _;

impl Canvas {
    /// Returns the SVG for a page: text uses the font of the page, style sheets select it by `class`, and screen readers
    /// read `title`.
    pub fn svg(&self, class: &str, title: &str) -> String {
        self.to_svg(&format!("class=\"{class}\" role=\"img\" aria-label=\"{}\"", escape_xml(title)), false)
    }

    /// Returns the SVG for print, `width_mm` wide: text as outlines, so no font is needed.
    pub fn svg_for_print(&self, width_mm: f64) -> String {
        let height_mm = width_mm * self.height / self.width;
        self.to_svg(&format!("width=\"{width_mm}mm\" height=\"{height_mm:.2}mm\""), true)
    }

    /// Returns the SVG with these attributes of its root; text is drawn as outlines if `outlined`.
    fn to_svg(&self, attributes: &str, outlined: bool) -> String {
        #[cfg(test)]
        super::outside::record(self);
        let (width, height) = (Short(self.width), Short(self.height));
        let out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" stroke-linejoin=\"round\" \
             {attributes}>"
        );
        let mut writer = Writer { out, open: None, outlined };
        writer.write_shapes(&self.shapes);
        writer.out + "</svg>"
    }
}

/// Writer of SVG elements.
struct Writer {
    out: String,
    /// Paint of the open group; shapes of equal paint share one group.
    open: Option<Paint>,
    outlined: bool,
}

impl Writer {
    /// Writes shapes, bottom first.
    fn write_shapes(&mut self, shapes: &[Shape]) {
        for shape in shapes {
            self.write_shape(shape);
        }
        self.set_paint(None);
    }

    /// Writes one shape.
    fn write_shape(&mut self, shape: &Shape) {
        match shape {
            Shape::Path(path, paint) => self.write_path(path, *paint),
            Shape::Circle([x, y], radius, paint) => {
                self.set_paint(Some(*paint));
                self.append(format_args!(
                    "<circle cx=\"{}\" cy=\"{}\" r=\"{}\"/>",
                    Short(*x),
                    Short(*y),
                    Short(*radius)
                ));
            }
            Shape::Text(text) if self.outlined => self.write_path(&outlines(text), Paint::fill(text.letters.colour)),
            Shape::Text(text) => self.write_text(text),
            Shape::RasterImage(at, size, pixels) => self.write_image(*at, *size, pixels),
            Shape::Group([x, y], scale, shapes) => {
                self.set_paint(None);
                let (x, y) = (Short(*x), Short(*y));
                self.append(format_args!("<g transform=\"translate({x} {y}) scale({scale:.4})\">"));
                self.write_shapes(shapes);
                self.out.push_str("</g>");
            }
        }
    }

    /// Appends markup.
    fn append(&mut self, text: std::fmt::Arguments<'_>) {
        self.out.write_fmt(text).expect("text takes all text");
    }

    /// Closes the open group and opens one of this paint, unless it is open; `None` only closes.
    fn set_paint(&mut self, paint: Option<Paint>) {
        if self.open == paint {
            return;
        }
        if self.open.is_some() {
            self.out.push_str("</g>");
        }
        if let Some(paint) = &paint {
            self.out.push_str("<g");
            self.append(format_args!(" fill=\"{}\"", paint.fill.map_or_else(|| "none".into(), Colour::css)));
            for (name, colour) in [("fill", paint.fill), ("stroke", paint.stroke)] {
                if let Some(colour) = colour.filter(|c| c.opacity < 1.0) {
                    self.append(format_args!(" {name}-opacity=\"{}\"", colour.opacity));
                }
            }
            if let Some(stroke) = paint.stroke {
                self.append(format_args!(" stroke=\"{}\" stroke-width=\"{}\"", stroke.css(), Short(paint.width)));
            }
            if !paint.dash.is_empty() {
                let lengths: Vec<String> = paint.dash.iter().map(f64::to_string).collect();
                self.append(format_args!(" stroke-dasharray=\"{}\"", lengths.join(" ")));
            }
            self.out.push_str(if paint.round { " stroke-linecap=\"round\">" } else { ">" });
        }
        self.open = paint;
    }

    /// Writes a path.
    fn write_path(&mut self, path: &VectorPath, paint: Paint) {
        self.set_paint(Some(paint));
        self.out.push_str("<path d=\"");
        let mut last = None;
        for step in &path.0 {
            match step {
                Step::Move([x, y]) => self.append(format_args!("M{} {}", Short(*x), Short(*y))),
                // A dot: with round ends, a segment of length 0 is visible.
                Step::Line(_) if last == Some(*step) => self.out.push_str("h0"),
                Step::Line([x, y]) => self.append(format_args!("L{} {}", Short(*x), Short(*y))),
                Step::Quad([x1, y1], [x, y]) => {
                    self.append(format_args!("Q{} {} {} {}", Short(*x1), Short(*y1), Short(*x), Short(*y)));
                }
                Step::Close => self.out.push('Z'),
            }
            let (Step::Move(end) | Step::Line(end) | Step::Quad(_, end)) = step else { continue };
            last = Some(Step::Line(*end));
        }
        self.out.push_str("\"/>");
    }

    /// Writes text.
    fn write_text(&mut self, text: &Text) {
        self.set_paint(Some(Paint::fill(text.letters.colour)));
        let anchor = match text.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let (x, y) = (Short(text.at[0]), Short(text.at[1]));
        self.out.push_str("<text ");
        if text.upright {
            self.append(format_args!("transform=\"translate({x} {y}) rotate(-90)\""));
        } else {
            self.append(format_args!("x=\"{x}\" y=\"{y}\""));
        }
        let (size, words) = (Short(text.letters.size), escape_xml(&text.words));
        self.append(format_args!(" font-size=\"{size}\" text-anchor=\"{anchor}\">{words}</text>"));
    }

    /// Writes an image.
    fn write_image(&mut self, [x, y]: Point, [width, height]: Point, pixels: &RasterImage) {
        self.set_paint(None);
        let png = encode_png(pixels.width as u32, pixels.height as u32, &pixels.rgba);
        let [x, y, width, height] = [x, y, width, height].map(Short);
        let sharp = if pixels.smooth { "" } else { " style=\"image-rendering:pixelated\"" };
        self.append(format_args!(
            "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" preserveAspectRatio=\"none\"{sharp} \
             href=\"data:image/png;base64,{}\"/>",
            STANDARD.encode(png)
        ));
    }
}

/// Length with at most two decimals.
#[derive(Clone, Copy)]
pub(super) struct Short(pub(super) f64);

impl std::fmt::Display for Short {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", (self.0 * 100.0).round() / 100.0 + 0.0) // without the sign of a zero
    }
}

/// Escapes text for XML and HTML, in elements and quoted attributes. Control characters except newlines and tabs become
/// `\u{fffd}`.
pub fn escape_xml(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in messages::escape_control(text).chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Not allowed in XML.
            '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::escape_xml;

    #[test]
    fn escapes_xml_special_characters() {
        assert_eq!(
            escape_xml("\"/><a href='x'> & \u{1b}[2J\n\0"),
            "&quot;/&gt;&lt;a href=&#39;x&#39;&gt; &amp; \u{fffd}[2J\n\u{fffd}"
        );
        assert_eq!(escape_xml("λ = 0,1 – 模"), "λ = 0,1 – 模");
    }
}

//! `Sheet`: a picture put together from pieces of SVG, in the sizes of the charts beside it.

use crate::draw::charts::text_width;
use std::fmt::Write as _;

/// Height of text: that of charts, whose library writes 14 as 14/1.24.
pub(super) const TEXT: f64 = 11.3;
/// Height of a line of text.
pub(super) const LINE: f64 = 14.0;

/// A picture under construction; lengths in SVG units, 380 to a column.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    /// Width.
    pub(super) width: f64,
    /// Height, known in the end.
    pub(super) height: f64,
    /// On paper.
    pub(super) width_mm: f64,
    body: String,
}

impl Sheet {
    /// As wide as a column.
    pub(super) fn column() -> Self {
        Self { width: 380.0, height: 0.0, width_mm: super::COLUMN_MM, body: String::new() }
    }

    /// As wide as two columns and the gap between them.
    pub(super) fn page() -> Self {
        Self { width: 380.0 * super::PAGE_MM / super::COLUMN_MM, width_mm: super::PAGE_MM, ..Self::column() }
    }

    /// A piece of SVG, moved to `at` and scaled.
    pub(super) fn piece(&mut self, [x, y]: [f64; 2], scale: f64, svg: &str) {
        _ = write!(self.body, "<g transform=\"translate({x:.2} {y:.2}) scale({scale:.4})\">{svg}</g>");
    }

    /// A thin line.
    pub(super) fn line(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], colour: &str) {
        let path = format!("M{x1:.2} {y1:.2}L{x2:.2} {y2:.2}");
        _ = write!(self.body, "<path stroke=\"{colour}\" stroke-width=\".9\" d=\"{path}\"/>");
    }

    /// A filled box with a thin dark border.
    pub(super) fn rect(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], colour: &str) {
        if width < 0.005 || height < 0.005 {
            return; // nothing to see: a stage that took no time
        }
        _ = write!(
            self.body,
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"{colour}\" \
             stroke=\"#464a52\" stroke-width=\".6\"/>"
        );
    }

    /// A grey picture of pixels, unsmoothed, with a frame.
    pub(super) fn pixels(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], data: &str) {
        _ = write!(
            self.body,
            "<image x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" \
             preserveAspectRatio=\"none\" image-rendering=\"optimizeSpeed\" href=\"{data}\"/>\
             <rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"none\" \
             stroke=\"#464a52\" stroke-width=\".6\"/>"
        );
    }

    /// Text whose base line begins, has its middle or ends (`anchor`) at a place.
    pub(super) fn text(&mut self, [x, y]: [f64; 2], anchor: &str, text: &str) {
        let text = escaped(text);
        _ = write!(self.body, "<text x=\"{x:.2}\" y=\"{y:.2}\" text-anchor=\"{anchor}\">{text}</text>");
    }

    /// Lines of text, the middle of all of them at the height of `at`.
    pub(super) fn lines(&mut self, [x, y]: [f64; 2], anchor: &str, lines: &[String]) {
        let first = y + 0.35 * TEXT - LINE * (lines.len() as f64 - 1.0) / 2.0;
        for (k, line) in lines.iter().enumerate() {
            self.text([x, first + LINE * k as f64], anchor, line);
        }
    }

    /// Text that reads upwards, its middle at a place.
    pub(super) fn upright(&mut self, [x, y]: [f64; 2], text: &str) {
        let turned = format!("transform=\"translate({x:.2} {y:.2}) rotate(-90)\"");
        _ = write!(self.body, "<text {turned} text-anchor=\"middle\">{}</text>", escaped(text));
    }

    /// The whole picture.
    pub(super) fn svg(&self) -> String {
        let Self { width, height, body, .. } = self;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.2} {height:.2}\" \
             font-family=\"sans-serif\"><g font-size=\"{TEXT}\" fill=\"#464a52\">{body}</g></svg>"
        )
    }
}

/// Text in XML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// `text` in lines no wider than `width`, broken after its commas; what is too long even then is cut.
pub(super) fn wrapped(text: &str, width: f64) -> Vec<String> {
    let fits = |line: &str| f64::from(text_width(line)) <= width;
    let mut lines: Vec<String> = Vec::new();
    for part in text.split_inclusive(", ") {
        match lines.last_mut() {
            Some(line) if fits((line.clone() + part).trim_end()) => line.push_str(part),
            _ => lines.push(part.to_owned()),
        }
    }
    lines.iter().map(|line| cut(line.trim_end(), width)).collect()
}

/// The longest beginning of `text` that fits, with two dots where it is cut.
fn cut(text: &str, width: f64) -> String {
    if f64::from(text_width(text)) <= width {
        return text.to_owned();
    }
    let letters: Vec<char> = text.chars().collect();
    let short = |n: usize| letters[..n].iter().collect::<String>().trim_end().to_owned() + "..";
    (1..letters.len()).rev().map(short).find(|s| f64::from(text_width(s)) <= width).unwrap_or_else(|| "..".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_are_cut_and_signs_escaped() {
        assert_eq!(cut("lambda 0.02", 500.0), "lambda 0.02");
        let short = cut("an initializer with a very long name", 90.0);
        assert!(short.starts_with("an init") && short.ends_with("..") && text_width(&short) <= 90, "{short}");
        assert_eq!(cut("anything", 1.0), "..");
        assert_eq!(wrapped("init cloud, lambda 0.02", 120.0), ["init cloud,", "lambda 0.02"]);
        assert_eq!(wrapped("init cloud, lambda 0.02", 500.0), ["init cloud, lambda 0.02"]);
        let mut sheet = Sheet::column();
        sheet.text([0.0, 0.0], "start", "N < 5 & more");
        assert!(sheet.svg().contains("N &lt; 5 &amp; more"));
    }
}

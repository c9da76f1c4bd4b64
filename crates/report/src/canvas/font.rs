//! Built-in font: width of text, outlines, and line breaks.

use super::{Anchor, Point, Step, TEXT, Text, VectorPath};
use std::sync::LazyLock;
use ttf_parser::{Face, GlyphId, OutlineBuilder};

static FACE: LazyLock<Face<'static>> =
    LazyLock::new(|| Face::parse(include_bytes!("../../assets/labels.ttf"), 0).expect("the built-in font is one"));

/// Returns the glyph and its width for text of height 1; a box if the font has no such glyph.
fn glyph(letter: char) -> (GlyphId, f64) {
    let glyph = FACE.glyph_index(letter).unwrap_or_default();
    (glyph, f64::from(FACE.glyph_hor_advance(glyph).unwrap_or(0)) / f64::from(FACE.units_per_em()))
}

/// Returns the width of text of height [`TEXT`].
pub fn text_width(words: &str) -> f64 {
    TEXT * words.chars().map(|c| glyph(c).1).sum::<f64>()
}

/// Returns the outlines of a text at its position.
pub(super) fn outlines(text: &Text) -> VectorPath {
    let size = text.letters.size;
    let width = size / TEXT * text_width(&text.words);
    let share = match text.anchor {
        Anchor::Start => 0.0,
        Anchor::Middle => 0.5,
        Anchor::End => 1.0,
    };
    let scale = size / f64::from(FACE.units_per_em());
    let mut pen = Pen { at: text.at, along: -share * width, scale, upright: text.upright, path: VectorPath::default() };
    for letter in text.words.chars() {
        let (glyph, width) = glyph(letter);
        FACE.outline_glyph(glyph, &mut pen);
        pen.along += size * width;
    }
    pen.path
}

/// Writer of glyph outlines.
struct Pen {
    at: Point,
    /// Start of the glyph on its line.
    along: f64,
    scale: f64,
    upright: bool,
    path: VectorPath,
}

impl Pen {
    /// Converts a point of the current glyph, in font units, to a position on the drawing.
    fn point(&self, x: f32, y: f32) -> Point {
        let (along, up) = (self.along + self.scale * f64::from(x), self.scale * f64::from(y));
        let [x, y] = self.at;
        if self.upright { [x - up, y - along] } else { [x + along, y - up] }
    }
}

impl OutlineBuilder for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        self.path.0.push(Step::Move(self.point(x, y)));
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.path.0.push(Step::Line(self.point(x, y)));
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.path.0.push(Step::Quad(self.point(x1, y1), self.point(x, y)));
    }

    fn curve_to(&mut self, _: f32, _: f32, _: f32, _: f32, _: f32, _: f32) {
        unreachable!("a TrueType font has only parabolas");
    }

    fn close(&mut self) {
        self.path.0.push(Step::Close);
    }
}

/// Breaks `text` of height [`TEXT`] after commas into lines no wider than `width`, longer parts at spaces, but not between
/// a word and its number; longer words are cut. Empty text has no lines.
pub fn wrap_text(text: &str, width: f64) -> Vec<String> {
    let lines = break_after(text, ", ", width);
    let parts = |line: &String| join_numbers_to_words(break_after(line, " ", width), width);
    lines.iter().flat_map(parts).map(|line| truncate_text(&line, width)).collect()
}

/// Moves the last of several words of a line to the next line if that begins with a number, and both fit into `width`.
fn join_numbers_to_words(mut lines: Vec<String>, width: f64) -> Vec<String> {
    for k in 1..lines.len() {
        let is_number = lines[k].starts_with(|c: char| c.is_ascii_digit() || "=-−+.".contains(c));
        let Some((start, name)) = lines[k - 1].rsplit_once(' ').filter(|_| is_number) else { continue };
        let (start, joined) = (start.to_owned(), format!("{name} {}", lines[k]));
        if text_width(&joined) <= width {
            (lines[k - 1], lines[k]) = (start, joined);
        }
    }
    lines
}

/// Breaks `text` after `mark` into lines no wider than `width`; a part without `mark` may be wider.
fn break_after(text: &str, mark: &str, width: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for part in text.split_inclusive(mark) {
        match lines.last_mut() {
            Some(line) if text_width((line.clone() + part).trim_end()) <= width => line.push_str(part),
            _ => lines.push(part.to_owned()),
        }
    }
    lines.iter().map(|line| line.trim_end().to_owned()).collect()
}

/// Returns `text` of height [`TEXT`] if it fits into `width`, otherwise the longest start that fits with two dots.
pub fn truncate_text(text: &str, width: f64) -> String {
    if text_width(text) <= width {
        return text.to_owned();
    }
    let fits = |end: &usize| text_width(&text[..*end]) + text_width("..") <= width;
    let end = text.char_indices().map(|(end, _)| end).take_while(fits).last().unwrap_or(0);
    text[..end].trim_end().to_owned() + ".."
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn breaks_and_truncates_long_names() {
        assert_eq!(truncate_text("lambda 0.02", 500.0), "lambda 0.02");
        let short = truncate_text("an initializer with a very long name", 90.0);
        assert!(short.starts_with("an init") && short.ends_with("..") && text_width(&short) <= 90.0, "{short}");
        assert_eq!(truncate_text("anything", 1.0), "..");
        assert_eq!(wrap_text("init cloud, lambda 0.02", 110.0), ["init cloud,", "lambda 0.02"]);
        assert_eq!(wrap_text("pruner LightGaussian 120", 120.0), ["pruner", "LightGaussian 120"]);
        assert_eq!(wrap_text("init cloud, lambda 0.02", 500.0), ["init cloud, lambda 0.02"]);
        assert_eq!(wrap_text("pruned masks λ 0.02", text_width("pruned masks λ")), ["pruned masks", "λ 0.02"]);
    }

    #[test]
    fn characters_missing_in_font_are_boxes() {
        assert!(text_width("模") > 0.0);
        assert!(["η", "ρ", "−", "±", "Δ", "λ", "²"].iter().all(|c| glyph(c.chars().next().unwrap()).0.0 != 0));
    }
}

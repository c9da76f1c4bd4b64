//! How variants and baselines look in every figure of a study.

use crate::draw::marks::{Marker, Stroke, Style};
use plotters::style::RGBColor;

/// Told apart by the colour-blind (Okabe and Ito, without yellow, which is lost on white); neighbours differ in lightness.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 90, 160),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(120, 40, 110),
    RGBColor(230, 159, 0),
    RGBColor(16, 19, 24),
    RGBColor(86, 180, 233),
    RGBColor(204, 121, 167),
];
/// Greys and dashes of baselines.
const GREYS: [RGBColor; 2] = [RGBColor(60, 63, 70), RGBColor(140, 144, 152)];
const DASHES: [Stroke; 3] = [Stroke::Dashed, Stroke::Dotted, Stroke::DashDotted];
/// Published numbers.
const GREY: RGBColor = RGBColor(110, 114, 122);

/// Four stages from dark to light: told apart by lightness alone.
pub(super) const SHADES: [&str; 4] = ["#123a6b", "#3f7fb8", "#93c0de", "#e6f0f7"];

/// The `k`-th variant: eight colours with eight markers, then the same dashed.
pub(super) fn variant(k: usize) -> Style {
    let strokes = [Stroke::Full, Stroke::Dashed, Stroke::DashDotted, Stroke::Dotted];
    Style {
        colour: COLOURS[k % COLOURS.len()],
        width: 2,
        stroke: strokes[k / COLOURS.len() % strokes.len()],
        marker: Some(Marker::ALL[k % Marker::ALL.len()]),
        hollow: k / COLOURS.len() % 2 == 1,
    }
}

/// The `k`-th baseline.
pub(super) fn floor(k: usize) -> Style {
    Style::line(GREYS[k / DASHES.len() % GREYS.len()], 1, DASHES[k % DASHES.len()])
}

/// Published points.
pub(super) fn published() -> Style {
    Style { marker: Some(Marker::Star), hollow: true, ..Style::line(GREY, 1, Stroke::None) }
}

/// The line that joins variants.
pub(super) fn thread() -> Style {
    Style::line(RGBColor(175, 179, 187), 1, Stroke::Full)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twelve_variants_differ_without_colour() {
        let shapes: Vec<_> = (0..12).map(variant).map(|s| (s.marker, s.stroke, s.hollow)).collect();
        for (k, shape) in shapes.iter().enumerate() {
            assert!(!shapes[..k].contains(shape), "variant {k}");
        }
    }
}

//! How variants and baselines look in every figure of a study.

use crate::canvas::Colour;
use crate::draw::marks::{Marker, Stroke, Style};

/// Told apart by the colour-blind (Okabe and Ito, without yellow, which is lost on white); neighbours differ in lightness.
const COLOURS: [u32; 8] = [0x00_5aa0, 0xd5_5e00, 0x00_9e73, 0x78_286e, 0xe6_9f00, 0x10_1318, 0x56_b4e9, 0xcc_79a7];
/// Greys and dashes of baselines.
const GREYS: [u32; 2] = [0x3c_3f46, 0x8c_9098];
const DASHES: [Stroke; 3] = [Stroke::DASHED, Stroke::DOTTED, Stroke::DASH_DOTTED];
/// Published numbers.
const GREY: Colour = Colour::hex(0x6e_727a);

/// Four stages from dark to light: told apart by lightness alone.
pub(super) const SHADES: [u32; 4] = [0x12_3a6b, 0x3f_7fb8, 0x93_c0de, 0xe6_f0f7];

/// The `k`-th variant: eight colours with eight markers, then the same dashed.
pub(super) fn variant(k: usize) -> Style {
    let strokes = [Stroke::FULL, Stroke::DASHED, Stroke::DASH_DOTTED, Stroke::DOTTED];
    Style {
        colour: Colour::hex(COLOURS[k % COLOURS.len()]),
        width: 2.0,
        stroke: strokes[k / COLOURS.len() % strokes.len()],
        marker: Some(Marker::ALL[k % Marker::ALL.len()]),
        hollow: k / COLOURS.len() % 2 == 1,
    }
}

/// The `k`-th baseline.
pub(super) fn floor(k: usize) -> Style {
    Style::line(Colour::hex(GREYS[k / DASHES.len() % GREYS.len()]), 1.0, DASHES[k % DASHES.len()])
}

/// Published points.
pub(super) fn published() -> Style {
    Style { marker: Some(Marker::Star), hollow: true, ..Style::line(GREY, 1.0, Stroke::None) }
}

/// The line that joins variants.
pub(super) fn thread() -> Style {
    Style::line(Colour::hex(0xaf_b3bb), 1.0, Stroke::FULL)
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

//! Perceptually uniform colour scales that are safe for colour-blind readers: lightness is linear in the value
//! (`OKLab`).

/// Red, green, blue.
pub type Rgb = [u8; 3];

/// Hue (degrees) and chroma of the sequential scale at 0, 1/4, 1/2, 3/4, 1: violet, blue, teal, green, yellow.
const SEQUENTIAL: [(f64, f64); 5] = [(305.0, 0.10), (268.0, 0.115), (205.0, 0.085), (152.0, 0.14), (106.0, 0.175)];

/// Hues of the other scales, degrees.
const BLUE: f64 = 256.0;
const VERMILION: f64 = 40.0;

/// Returns a colour from dark violet at 0 to yellow at 1; other values are clamped.
pub fn sequential(value: f64) -> Rgb {
    let t = value.clamp(0.0, 1.0);
    let position = 4.0 * t;
    let k = (position as usize).min(3);
    let fraction = position - k as f64;
    let mix = |a: f64, b: f64| a + (b - a) * fraction;
    let ((h0, c0), (h1, c1)) = (SEQUENTIAL[k], SEQUENTIAL[k + 1]);
    // Lightness from 0.23 (dark) to 0.93 (light).
    srgb_from_oklch(0.23 + 0.70 * t, mix(c0, c1), mix(h0, h1))
}

/// Returns a colour from blue at −1 over white to vermilion at 1; other values are clamped.
pub fn diverging(value: f64) -> Rgb {
    let size = value.abs().min(1.0);
    let hue = if value < 0.0 { BLUE } else { VERMILION };
    // Lightness from 0.98 (white) to 0.48. With an exponent below 1, the hue of small values is visible.
    srgb_from_oklch(0.98 - 0.50 * size, 0.17 * size.powf(0.85), hue)
}

/// Returns a colour of a cyclic scale for values from 0 to 1: light, blue, dark, vermilion and light again. Hue
/// distinguishes the halves of equal lightness, also for colour-blind readers.
pub fn cyclic(value: f64) -> Rgb {
    let (sin, cos) = (std::f64::consts::TAU * value).sin_cos();
    // Lightness from 0.27 (dark) to 0.93 (light); both are grey.
    srgb_from_oklch(0.60 + 0.33 * cos, 0.13 * sin.abs(), if sin < 0.0 { VERMILION } else { BLUE })
}

/// Converts `OKLab` in polar form to sRGB (Björn Ottosson, 2020); colours outside the gamut are clipped.
fn srgb_from_oklch(lightness: f64, chroma: f64, hue_deg: f64) -> Rgb {
    let (sin, cos) = hue_deg.to_radians().sin_cos();
    let (a, b) = (chroma * cos, chroma * sin);
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    let linear = [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ];
    linear.map(|c| {
        let c = c.clamp(0.0, 1.0);
        let encoded = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
        (255.0 * encoded).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn luminance([r, g, b]: Rgb) -> f64 {
        let linear = |c: u8| (f64::from(c) / 255.0).powf(2.2);
        0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b)
    }

    #[test]
    fn cyclic_palette_has_no_seam() {
        let gap = |a: Rgb, b: Rgb| a.iter().zip(b).map(|(a, b)| a.abs_diff(b)).max().unwrap();
        let steps: Vec<Rgb> = (0..=100).map(|i| cyclic(f64::from(i) / 100.0)).collect();
        assert!(steps.windows(2).all(|w| gap(w[0], w[1]) < 16) && steps[0] == steps[100], "{steps:?}");
        assert!(luminance(steps[25]) < luminance(steps[0]) && luminance(steps[50]) < luminance(steps[25]));
    }

    #[test]
    fn palette_luminance_increases_with_value() {
        let steps: Vec<f64> = (0..=50).map(|i| luminance(sequential(f64::from(i) / 50.0))).collect();
        assert!(steps.windows(2).all(|w| w[1] > w[0]), "{steps:?}");
        for sign in [-1.0, 1.0] {
            let steps: Vec<f64> = (0..=20).map(|i| luminance(diverging(sign * f64::from(i) / 20.0))).collect();
            assert!(steps.windows(2).all(|w| w[1] < w[0]), "{steps:?}");
        }
    }
}

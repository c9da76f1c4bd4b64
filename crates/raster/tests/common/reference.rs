//! Reference of `AlphaBlending` by brute force: every splat against every pixel, one pixel after the other; the
//! derivative by the usual back-to-front pass.

use pwrfgs_core::{ImagePlane, Real, RenderVjp, Splats};

/// Largest γ of one splat, smallest drawn γ, and transmittance of an opaque pixel.
const ALPHA_MAX: Real = 0.99;
const ALPHA_MIN: Real = 1.0 / 255.0;
const T_MIN: Real = 1e-4;

/// One splat in one pixel.
struct Touch {
    i: usize,
    d: [Real; 2],
    gauss: Real,
    alpha: Real,
    before: Real,
}

/// Returns the splats in pixel (x, y), nearest first, and the remaining transmittance.
fn touches(splats: &Splats, order: &[usize], plane: &ImagePlane, x: usize, y: usize) -> (Vec<Touch>, Real) {
    let mut light = 1.0;
    let mut seen = Vec::new();
    for &i in order {
        let [mx, my] = splats.means2d[i];
        let mut d = [mx - x as Real, my - y as Real];
        if plane.wraps {
            let width = plane.width as Real;
            d[0] -= width * (d[0] / width + 0.5).floor();
        }
        let [a, b, c] = splats.conics[i];
        let power = -0.5 * (a * d[0] * d[0] + c * d[1] * d[1]) - b * d[0] * d[1];
        let gauss = power.exp();
        let alpha = (splats.opacities[i] * gauss).min(ALPHA_MAX);
        if power > 0.0 || alpha < ALPHA_MIN {
            continue;
        }
        if light * (1.0 - alpha) < T_MIN {
            break;
        }
        seen.push(Touch { i, d, gauss, alpha, before: light });
        light *= 1.0 - alpha;
    }
    (seen, light)
}

/// Returns the splats that reach the image, nearest first.
fn order_of(splats: &Splats) -> Vec<usize> {
    let mut order: Vec<usize> = (0..splats.len()).filter(|&i| splats.radii[i] > 0.0).collect();
    order.sort_by(|&a, &b| (splats.depths[a] as f32).total_cmp(&(splats.depths[b] as f32)));
    order
}

/// Returns blended signals `[channels, H, W]` and transmittance `[H, W]`.
pub(crate) fn forward(
    splats: &Splats,
    signals: &[Real],
    channels: usize,
    plane: &ImagePlane,
) -> (Vec<Real>, Vec<Real>) {
    let size = plane.width * plane.height;
    let (mut pixels, mut transmittance) = (vec![0.0; channels * size], vec![1.0; size]);
    let order = order_of(splats);
    for p in 0..size {
        let (seen, light) = touches(splats, &order, plane, p % plane.width, p / plane.width);
        transmittance[p] = light;
        for t in seen {
            for c in 0..channels {
                pixels[c * size + p] += signals[t.i * channels + c] * t.alpha * t.before;
            }
        }
    }
    (pixels, transmittance)
}

/// Returns cotangents, given those of the pixels.
pub(crate) fn backward(
    splats: &Splats,
    signals: &[Real],
    channels: usize,
    plane: &ImagePlane,
    d_pixels: &[Real],
) -> RenderVjp {
    let size = plane.width * plane.height;
    let n = splats.len();
    let mut out = RenderVjp { splats: Splats::zeros(n), signals: vec![0.0; n * channels], weights: vec![0.0; n] };
    let order = order_of(splats);
    for p in 0..size {
        let (seen, _) = touches(splats, &order, plane, p % plane.width, p / plane.width);
        let mut behind = vec![0.0; channels];
        for t in seen.iter().rev() {
            let mut d_alpha = 0.0;
            for c in 0..channels {
                let (s, g) = (signals[t.i * channels + c], d_pixels[c * size + p]);
                d_alpha += t.before * (s - behind[c]) * g;
                out.signals[t.i * channels + c] += t.alpha * t.before * g;
                behind[c] = t.alpha * s + (1.0 - t.alpha) * behind[c];
            }
            let d_power = d_alpha * splats.opacities[t.i] * t.gauss;
            let ([a, b, c], [dx, dy]) = (splats.conics[t.i], t.d);
            let d = &mut out.splats;
            d.means2d[t.i][0] -= d_power * (a * dx + b * dy);
            d.means2d[t.i][1] -= d_power * (c * dy + b * dx);
            d.conics[t.i][0] -= 0.5 * d_power * dx * dx;
            d.conics[t.i][1] -= d_power * dx * dy;
            d.conics[t.i][2] -= 0.5 * d_power * dy * dy;
            d.opacities[t.i] += d_alpha * t.gauss;
            out.weights[t.i] += t.alpha * t.before;
        }
    }
    out
}

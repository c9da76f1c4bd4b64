//! Statistics of splats in an image: weights, errors, ranks per pixel, derivatives. Pruners request this additional
//! pass over the tiles, front to back.

use crate::blend::{PIXELS, TILE, Tile};
use crate::canvas::gather_tile;
use pwrfgs_core::{Real, SplatStats, SurveyInputs};

/// Best splats of a pixel: value and index in the list of the tile, best first.
type TopSplats = Vec<(Real, usize)>;

/// Survey of one tile.
pub(crate) struct SurveyTile<'a, 'b> {
    pub(crate) tile: &'b Tile<'a>,
    /// Drawn image, `[channels, H, W]`.
    pub(crate) drawn: &'b [Real],
    pub(crate) survey: &'b SurveyInputs<'b>,
}

/// Inputs of the derivative with respect to γ in a tile: the derivatives of the readout by the channels `[channels][PIXELS]`,
/// and their product with the image behind the current splat, `[PIXELS]`.
struct Slopes {
    readout: Vec<Real>,
    q_behind: Vec<Real>,
    channels: usize,
}

impl Slopes {
    /// Gathers the derivatives of a tile; `None` if the survey needs none.
    fn new(survey_tile: &SurveyTile<'_, '_>) -> Option<Self> {
        let (_, slopes) = survey_tile.survey.slopes?;
        let Tile { channels, plane, corner, .. } = *survey_tile.tile;
        let (mut readout, mut drawn) = (vec![0.0; channels * PIXELS], vec![0.0; channels * PIXELS]);
        gather_tile(slopes, plane, corner, &mut readout);
        gather_tile(survey_tile.drawn, plane, corner, &mut drawn);
        let mut q_behind = vec![0.0; PIXELS];
        for (k, (slope, value)) in readout.iter().zip(&drawn).enumerate() {
            q_behind[k % PIXELS] += slope * value;
        }
        Some(Self { readout, q_behind, channels })
    }

    /// Returns ∂P̂/∂γ of a splat in pixel `p` of the tile, given the transmittance before the splat, γ, and its weight; removes
    /// the splat from the sum.
    #[inline(always)]
    fn pixel_derivative(&mut self, p: usize, signal: &[Real], (before, alpha, weight): (Real, Real, Real)) -> Real {
        let q: Real = (0..self.channels).map(|c| signal[c] * self.readout[c * PIXELS + p]).sum();
        self.q_behind[p] -= weight * q;
        before * q - self.q_behind[p] / (1.0 - alpha)
    }
}

impl pulp::WithSimd for SurveyTile<'_, '_> {
    type Output = Vec<SplatStats>;
    /// Computes the statistics of each splat in the list of the tile.
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<SplatStats> {
        let Self { tile, survey, .. } = &self;
        let mut tile_stats = vec![SplatStats::default(); tile.list.len()];
        let mut slopes = Slopes::new(&self);
        let mut top: Vec<TopSplats> = vec![Vec::new(); if survey.top.is_some() { PIXELS } else { 0 }];
        let mut transmittance = tile.initial_transmittance();
        for (k, (&i, &[first, end])) in tile.list.iter().zip(tile.rows).enumerate() {
            let i = i as usize;
            let splat = tile.splat_row(i);
            let stats = &mut tile_stats[k];
            for row in first as usize..end as usize {
                if !transmittance.is_live(row) {
                    continue;
                }
                let y = tile.corner.1 + row;
                let (gauss, raw) = splat.gauss_and_alpha(y as Real);
                let alpha = splat.with_existence(raw);
                let before = transmittance.row(row);
                let weight = transmittance.blend(row, &alpha);
                for lane in 0..TILE {
                    let (w, p) = (weight[lane], row * TILE + lane);
                    if w <= 0.0 {
                        continue;
                    }
                    let pixel = y * tile.plane.width + tile.corner.0 + lane;
                    add_pixel(stats, survey, pixel, w);
                    if let Some((count, truth, strengths)) = survey.top {
                        let value = (-(strengths[i] - truth[pixel]).abs()).exp() * w;
                        insert_top(&mut top[p], count, (value, k));
                    }
                    if let (Some(slopes), Some((signals, _))) = (&mut slopes, survey.slopes) {
                        let signal = &signals[i * slopes.channels..][..slopes.channels];
                        let d = slopes.pixel_derivative(p, signal, (before[lane], alpha[lane], w));
                        stats.sensitivity += (d * alpha[lane]).powi(2);
                        if survey.fisher {
                            let d_power = d * splat.existence * splat.opacity * gauss[lane];
                            let d = splat.exponent_slopes(lane, y as Real).map(|slope| d_power * slope);
                            add_outer_product(&mut stats.fisher, &d);
                        }
                    }
                }
            }
        }
        top.iter().flatten().for_each(|&(_, k)| tile_stats[k].top = true);
        tile_stats
    }
}

/// Adds a pixel with the blending weight `w` to the weights and errors of a splat.
#[inline(always)]
fn add_pixel(stats: &mut SplatStats, survey: &SurveyInputs<'_>, pixel: usize, w: Real) {
    stats.weight += w;
    stats.largest = stats.largest.max(w);
    stats.pixels += 1.0;
    stats.error += w * survey.errors.get(pixel).copied().unwrap_or(0.0);
    stats.high += Real::from(u8::from(survey.high.get(pixel).copied().unwrap_or(false)));
}

/// Inserts an entry into the best splats of a pixel, of which the `count` with the largest values are kept; ties keep
/// the earlier one.
fn insert_top(top: &mut TopSplats, count: usize, entry: (Real, usize)) {
    let at = top.partition_point(|(value, _)| *value >= entry.0);
    if at < count {
        top.insert(at, entry);
        top.truncate(count);
    }
}

/// Adds the upper triangle of x xᵀ to `sum`, by rows.
#[inline(always)]
fn add_outer_product(sum: &mut [Real; 15], x: &[Real; 5]) {
    let mut k = 0;
    for i in 0..5 {
        for j in i..5 {
            sum[k] += x[i] * x[j];
            k += 1;
        }
    }
}

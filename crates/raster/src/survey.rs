//! Statistics of splats in an image: weights, errors, ranks per pixel, derivatives. Pruners request this additional
//! pass over the tiles, front to back.

use crate::blend::{PIXELS, TILE, Tile};
use crate::canvas::gather;
use pwrfgs_core::{Real, SplatStats, SurveyInputs};

/// First splats of a pixel: value and index in the list of the tile, best first.
type First = Vec<(Real, usize)>;

/// Survey of one tile.
pub(crate) struct SurveyTile<'a, 'b> {
    pub(crate) tile: &'b Tile<'a>,
    /// Drawn image, `[channels, H, W]`.
    pub(crate) picture: &'b [Real],
    pub(crate) survey: &'b SurveyInputs<'b>,
}

/// Inputs of the derivative with respect to splat strength in a tile: `[channels][PIXELS]`, and the sum behind the
/// current splat.
struct Slopes {
    own: Vec<Real>,
    behind: Vec<Real>,
    channels: usize,
}

impl Slopes {
    fn of(survey_tile: &SurveyTile<'_, '_>) -> Option<Self> {
        let (_, slopes) = survey_tile.survey.slopes?;
        let Tile { channels, plane, corner, .. } = *survey_tile.tile;
        let (mut own, mut drawn) = (vec![0.0; channels * PIXELS], vec![0.0; channels * PIXELS]);
        gather(slopes, plane, corner, &mut own);
        gather(survey_tile.picture, plane, corner, &mut drawn);
        let mut behind = vec![0.0; PIXELS];
        for (k, (slope, value)) in own.iter().zip(&drawn).enumerate() {
            behind[k % PIXELS] += slope * value;
        }
        Some(Self { own, behind, channels })
    }

    /// Returns ∂P̂/∂γ of a splat in pixel `p` of the tile, and passes the splat.
    #[inline(always)]
    fn along(&mut self, p: usize, signal: &[Real], (before, alpha, weight): (Real, Real, Real)) -> Real {
        let q: Real = (0..self.channels).map(|c| signal[c] * self.own[c * PIXELS + p]).sum();
        self.behind[p] -= weight * q;
        before * q - self.behind[p] / (1.0 - alpha)
    }
}

impl pulp::WithSimd for SurveyTile<'_, '_> {
    type Output = Vec<SplatStats>;
    /// Computes the statistics of each splat in the list of the tile.
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<SplatStats> {
        let Self { tile, survey, .. } = &self;
        let mut found = vec![SplatStats::default(); tile.list.len()];
        let mut slopes = Slopes::of(&self);
        let mut first: Vec<First> = vec![Vec::new(); if survey.top.is_some() { PIXELS } else { 0 }];
        let mut light = tile.start();
        for (k, (&i, &[top, end])) in tile.list.iter().zip(tile.rows).enumerate() {
            let i = i as usize;
            let brush = tile.brush(i);
            let own = &mut found[k];
            for row in top as usize..end as usize {
                if !light.is_open(row) {
                    continue;
                }
                let y = tile.corner.1 + row;
                let (gauss, raw) = brush.alpha(y as Real);
                let alpha = brush.veiled(raw);
                let before = light.row(row);
                let weight = light.pass(row, &alpha);
                for lane in 0..TILE {
                    let (w, p) = (weight[lane], row * TILE + lane);
                    if w <= 0.0 {
                        continue;
                    }
                    let pixel = y * tile.plane.width + tile.corner.0 + lane;
                    own.weight += w;
                    own.largest = own.largest.max(w);
                    own.pixels += 1.0;
                    own.error += w * survey.errors.get(pixel).copied().unwrap_or(0.0);
                    own.high += Real::from(u8::from(survey.high.get(pixel).copied().unwrap_or(false)));
                    if let Some((count, truth, strengths)) = survey.top {
                        let value = (-(strengths[i] - truth[pixel]).abs()).exp() * w;
                        place(&mut first[p], count, (value, k));
                    }
                    if let (Some(slopes), Some((signals, _))) = (&mut slopes, survey.slopes) {
                        let signal = &signals[i * slopes.channels..][..slopes.channels];
                        let d = slopes.along(p, signal, (before[lane], alpha[lane], w));
                        own.sensitivity += (d * alpha[lane]).powi(2);
                        if survey.fisher {
                            let d_power = d * brush.existence * brush.opacity * gauss[lane];
                            outer(&mut own.fisher, &brush.slopes(lane, y as Real).map(|slope| d_power * slope));
                        }
                    }
                }
            }
        }
        first.iter().flatten().for_each(|&(_, k)| found[k].top = true);
        found
    }
}

/// Keeps the `count` largest values; ties keep the earlier one.
fn place(first: &mut First, count: usize, entry: (Real, usize)) {
    let at = first.partition_point(|(value, _)| *value >= entry.0);
    if at < count {
        first.insert(at, entry);
        first.truncate(count);
    }
}

/// Adds the upper triangle of x xᵀ.
#[inline(always)]
fn outer(sum: &mut [Real; 15], x: &[Real; 5]) {
    let mut k = 0;
    for i in 0..5 {
        for j in i..5 {
            sum[k] += x[i] * x[j];
            k += 1;
        }
    }
}

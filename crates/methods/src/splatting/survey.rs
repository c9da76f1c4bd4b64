//! Statistics of each Gaussian's effect on the observations, for pruners.

use super::{BlendedSignals, Geometry, ReceiverView, Splatting};
use crate::Calibration;
use crate::groups::ReceiverGroup;
use pwrfgs_core::{Call, Deltas, Needs, Parameters, PassStatistics, Real, SplatStats, Splats, Statistic, SurveyInputs};
use std::sync::Arc;

/// Derivatives `[5, 6]` of mean (2) and conic (3) of a splat by mean (3) and log scale (3) of its Gaussian.
type Jacobian = [[Real; 6]; 5];

/// Arguments of [`pwrfgs_core::Method::survey`].
pub(super) struct SurveyRequest<'a> {
    pub(super) call: &'a Call<'a>,
    pub(super) truths: &'a [Real],
    pub(super) needs: &'a Needs,
}

impl SurveyRequest<'_> {
    /// Returns whether a requested statistic matches.
    fn requires_any(&self, matches: fn(&Statistic) -> bool) -> bool {
        self.needs.statistics.iter().any(matches)
    }
}

impl Splatting {
    /// Collects the requested statistics of all links of the call, merged by [`PassStatistics::merge`].
    pub(super) fn run_survey(&self, request: &SurveyRequest<'_>) -> PassStatistics {
        let SurveyRequest { call, needs, .. } = *request;
        let Call { setup, parameters: p, links, .. } = call;
        let (sky, n) = (self.sky(setup), p.cloud.len());
        let is_static = !self.deformation.traits().varies_geometry;
        let skips_network = is_static && !request.requires_any(requires_signals);
        // Weights then depend on the geometry only, not on the outputs of the network.
        let deltas = if skips_network { Deltas::default() } else { self.network_terms(call, &None, false).0 };
        let rows: Vec<usize> = (0..n).collect();
        let mut sums = PassStatistics::zeros(needs, n);
        for group in ReceiverGroup::from_links(links, is_static) {
            let view = &ReceiverView { pose: group.state.pose, plane: sky.clone() };
            let (terms, batch) = group.gather_terms(&deltas, n);
            let geometry = Arc::new(self.geometry(view, p, &terms, batch.start));
            if !request.requires_any(is_per_link) {
                let signals = (!skips_network).then(|| self.activation().signals(p.cloud, &terms, batch.clone()));
                sums.merge(&rows, &self.shared_statistics(view, batch.len(), signals, &geometry, needs));
                continue;
            }
            let jacobians = if request.requires_any(|s| *s == Statistic::Fisher) {
                self.jacobians(view, p, &geometry)
            } else {
                Vec::new()
            };
            for (b, link) in batch.zip(group.split_links()) {
                let drawing = self.draw(view, p, &terms, b..b + 1, Some(&geometry));
                sums.merge(&rows, &self.link_statistics(request, view, &link, &drawing, &jacobians));
            }
        }
        sums
    }

    /// Returns ∂observation/∂blended of a link, summed over the values of the observation, in the shape of `blended`.
    fn observation_slopes(
        &self,
        request: &SurveyRequest<'_>,
        view: &ReceiverView,
        link: &ReceiverGroup,
        blended: &[Real],
    ) -> Vec<Real> {
        let Call { setup, parameters: p, .. } = request.call;
        if setup.task.has_pixels && self.calibration == Calibration::Physical {
            return self.readout.pixel_slopes(blended, view.plane.width * view.plane.height);
        }
        let mut law = [0.0; 2];
        let d_law = self.split_weights(setup, p.weights).1.receiver_law(link.state.receiver).map(|_| &mut law);
        self.read_out_vjp(view, d_law, &link.distances(request.call), blended, &vec![1.0; setup.value_count()])
    }

    /// Returns the statistics of all links of a geometry together: the blending weights are equal, only `signals`
    /// `[N, links · channels]` differ. These are `None` if no statistic reads them.
    fn shared_statistics(
        &self,
        view: &ReceiverView,
        links: usize,
        signals: Option<Vec<Real>>,
        geometry: &Geometry,
        needs: &Needs,
    ) -> PassStatistics {
        let (splats, channels) = (&geometry.splats, self.readout.channel_count());
        let n = splats.len();
        // Only blending weights are needed, so that the signals are arbitrary.
        let render =
            self.rasterizer.forward_prepared(splats.with_signals(&vec![1.0; n], 1, &view.plane), &geometry.cache);
        let splat_stats = self.rasterizer.survey(splats, &view.plane, &render, &SurveyInputs::default());
        let mut statistics = PassStatistics::zeros(needs, n);
        statistics.links = links;
        let mut strengths: [Vec<Real>; 2] =
            [vec![0.0; statistics.signal_mean.len()], vec![0.0; statistics.signal_mean.len()]];
        if let Some(signals) = signals.filter(|_| !statistics.signal_mean.is_empty()) {
            let [sums, largest] = &mut strengths;
            for (i, signal) in signals.chunks_exact(links * channels).enumerate() {
                for strength in signal.chunks_exact(channels).map(signal_strength) {
                    sums[i] += strength;
                    largest[i] = largest[i].max(strength);
                }
            }
        }
        fill_weights(&mut statistics, &splat_stats, [&strengths[0], &strengths[1]]);
        statistics
    }

    /// Returns the statistics of one link, whose image is `drawing`; `jacobians` are empty unless one of them is the Fisher
    /// information.
    fn link_statistics(
        &self,
        request: &SurveyRequest<'_>,
        view: &ReceiverView,
        link: &ReceiverGroup,
        drawing: &BlendedSignals,
        jacobians: &[Jacobian],
    ) -> PassStatistics {
        let SurveyRequest { call: Call { setup, .. }, truths, needs } = *request;
        let BlendedSignals { geometry, signals, render, .. } = drawing;
        let (splats, channels) = (&geometry.splats, self.readout.channel_count());
        let truth = &truths[link.first_link() * setup.value_count()..][..setup.value_count()];
        let predicted = self.read_out(request.call, view, link, &self.clamp_as_released(&render.pixels));
        let slopes = self.observation_slopes(request, view, link, &render.pixels);
        let strengths: Vec<Real> = signals.chunks_exact(channels).map(signal_strength).collect();
        let errors: Vec<Real> = predicted.iter().zip(truth).map(|(a, b)| (a - b).abs()).collect();
        let (mut survey, high) = (SurveyInputs::default(), high_errors(&errors, needs));
        if setup.task.has_pixels {
            if request.requires_any(|s| matches!(s, Statistic::Error { .. })) {
                (survey.errors, survey.high) = (&errors, &high);
            }
            let top = |s: &Statistic| if let Statistic::Top { count } = *s { Some(count) } else { None };
            survey.top = needs.statistics.iter().find_map(top).map(|count| (count, truth, &strengths[..]));
            if request.requires_any(|s| matches!(s, Statistic::Sensitivity | Statistic::Fisher)) {
                survey.slopes = Some((signals, &slopes));
                survey.fisher = !jacobians.is_empty();
            }
        }
        let mut splat_stats = self.rasterizer.survey(splats, &view.plane, render, &survey);
        if setup.task.is_scalar {
            self.fill_scalar_derivatives(view, drawing, &slopes, &mut splat_stats);
        }
        let mut statistics = PassStatistics::zeros(needs, splats.len());
        statistics.links = 1;
        fill_weights(&mut statistics, &splat_stats, [&strengths, &strengths]);
        fill_link_columns(&mut statistics, &splat_stats, &errors, jacobians);
        statistics
    }

    /// Replaces sensitivity and Fisher information in `splat_stats` by those of a power, a single value: the derivatives
    /// of its pixels are summed before they are squared.
    fn fill_scalar_derivatives(
        &self,
        view: &ReceiverView,
        drawing: &BlendedSignals,
        slopes: &[Real],
        splat_stats: &mut [SplatStats],
    ) {
        let BlendedSignals { geometry, signals, render, .. } = drawing;
        let mut splats = geometry.splats.clone();
        if splats.existence.is_empty() {
            splats.existence = vec![1.0; splats.len()];
        }
        let channels = self.readout.channel_count();
        let d = self.rasterizer.backward(splats.with_signals(signals, channels, &view.plane), render, slopes);
        for (i, stats) in splat_stats.iter_mut().enumerate() {
            stats.sensitivity = (splats.existence[i] * d.splats.existence[i]).powi(2);
            let ([x, y], [a, b, c]) = (d.splats.means2d[i], d.splats.conics[i]);
            let slopes = [x, y, a, b, c];
            let pairs = (0..5).flat_map(|j| (j..5).map(move |k| (j, k))); // the order that `transform_fisher` reads
            stats.fisher.iter_mut().zip(pairs).for_each(|(v, (j, k))| *v = slopes[j] * slopes[k]);
        }
    }

    /// Returns the derivatives of the splats by their Gaussians: one backward pass of the projector per splat value,
    /// five in all.
    fn jacobians(&self, view: &ReceiverView, p: &Parameters<'_>, geometry: &Geometry) -> Vec<Jacobian> {
        let n = geometry.splats.len();
        let mut jacobians = vec![[[0.0; 6]; 5]; n];
        for k in 0..5 {
            let mut d = Splats::zeros(n);
            match k {
                0 | 1 => d.means2d.iter_mut().for_each(|mean| mean[k] = 1.0),
                _ => d.conics.iter_mut().for_each(|conic| conic[k - 2] = 1.0),
            }
            let d = self.project_vjp(view, geometry, &d);
            for (i, jacobian) in jacobians.iter_mut().enumerate() {
                let gate = p.gate.map_or(1.0, |gate| gate[i]);
                let scale = [0, 1, 2].map(|j| d.scales[i][j] * gate * p.cloud.log_scales[i][j].exp());
                let mean = d.means[i];
                jacobian[k] = [mean[0], mean[1], mean[2], scale[0], scale[1], scale[2]];
            }
        }
        jacobians
    }
}

/// Returns whether a statistic differs per link even for equal geometry.
fn is_per_link(statistic: &Statistic) -> bool {
    use Statistic::{Error, Fisher, Sensitivity, Top};
    matches!(statistic, Error { .. } | Top { .. } | Sensitivity | Fisher)
}

/// Returns whether a statistic depends on signals.
fn requires_signals(statistic: &Statistic) -> bool {
    is_per_link(statistic) || *statistic == Statistic::SignalWeight
}

/// Fills the requested statistics of weights, given the sums and the maxima of the strengths over the links.
fn fill_weights(statistics: &mut PassStatistics, splat_stats: &[SplatStats], [sums, largest]: [&[Real]; 2]) {
    let times = statistics.links as Real;
    fill_column(&mut statistics.weight, splat_stats, |_, splat| times * splat.weight);
    fill_column(&mut statistics.largest_weight, splat_stats, |_, splat| splat.largest);
    fill_column(&mut statistics.weight_per_area, splat_stats, |_, splat| times * splat.weight / splat.pixels.max(1.0));
    fill_column(&mut statistics.signal_mean, splat_stats, |i, splat| sums[i] * splat.weight);
    fill_column(&mut statistics.signal_max, splat_stats, |i, splat| largest[i] * splat.weight);
}

/// Fills the requested statistics that differ per link, given the absolute errors of the values of the link.
fn fill_link_columns(
    statistics: &mut PassStatistics,
    splat_stats: &[SplatStats],
    errors: &[Real],
    jacobians: &[Jacobian],
) {
    let mean_error = errors.iter().sum::<Real>() / errors.len().max(1) as Real;
    fill_column(&mut statistics.error, splat_stats, |_, splat| splat.error);
    fill_column(&mut statistics.high_error, splat_stats, |_, splat| mean_error * splat.high);
    fill_column(&mut statistics.sensitivity, splat_stats, |_, splat| splat.sensitivity);
    statistics.top.iter_mut().zip(splat_stats).for_each(|(v, splat)| *v = splat.top);
    let fishers = statistics.fisher.iter_mut().zip(jacobians).zip(splat_stats);
    fishers.for_each(|((v, jacobian), splat)| *v = transform_fisher(&splat.fisher, jacobian));
}

/// Fills a statistic with one value per Gaussian; a statistic that is not requested is empty and stays so.
fn fill_column(column: &mut [Real], splat_stats: &[SplatStats], value: impl Fn(usize, &SplatStats) -> Real) {
    column.iter_mut().zip(splat_stats.iter().enumerate()).for_each(|(v, (i, splat))| *v = value(i, splat));
}

/// Returns the magnitude of a signal `[channels]`.
fn signal_strength(signal: &[Real]) -> Real {
    signal.iter().map(|s| s * s).sum::<Real>().sqrt()
}

/// Returns whether the error of each pixel is above the requested fraction of the range from the smallest to the largest
/// error; empty if no statistic requests it.
fn high_errors(errors: &[Real], needs: &Needs) -> Vec<bool> {
    let request =
        needs.statistics.iter().find_map(|s| if let Statistic::Error { high } = s { Some(*high) } else { None });
    let Some(share) = request else { return Vec::new() };
    let low = errors.iter().copied().fold(Real::INFINITY, Real::min);
    let most = errors.iter().copied().fold(Real::NEG_INFINITY, Real::max);
    errors.iter().map(|e| *e > low + share * (most - low)).collect()
}

/// Transforms Fisher information from splats to Gaussians: returns Jᵀ F J, the upper triangle of 6 × 6 numbers from that
/// of 5 × 5, both row by row.
fn transform_fisher(fisher: &[Real; 15], jacobian: &Jacobian) -> [Real; 21] {
    let mut full = [[0.0; 5]; 5];
    let mut entries = fisher.iter();
    for j in 0..5 {
        for k in j..5 {
            let v = *entries.next().expect("fifteen numbers");
            (full[j][k], full[k][j]) = (v, v);
        }
    }
    let mut out = [0.0; 21];
    let mut entry = out.iter_mut();
    for a in 0..6 {
        for b in a..6 {
            let sum = (0..25).map(|e| jacobian[e / 5][a] * full[e / 5][e % 5] * jacobian[e % 5][b]).sum();
            *entry.next().expect("twenty-one numbers") = sum;
        }
    }
    out
}

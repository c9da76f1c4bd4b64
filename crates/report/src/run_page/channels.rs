//! Channels on the page: magnitude and phase of a few links, power delay profiles, and the virtual transmitters
//! of a model without splats.

mod virtual_map;

use super::examples::Example;
use crate::canvas::{BLACK, Colour};
use crate::draw::charts::{Chart, ChartAxis, ChartLine, ChartStyle};
use crate::draw::marks::{Marker, Stroke, Style};
use minijinja::{Value, context};
use pwrfgs_core::{Image, evenly, gains_of};
use pwrfgs_experiment::{LoadedRun, text::number};
use std::f64::consts::TAU;

/// Maximum number of links on the complex plane.
const DOTS: usize = 150;
const MEASURED: Colour = BLACK;
const PREDICTED: Colour = Colour::hex(0xd5_5e00);
/// Maximum number of marks on a line.
const MARKS: usize = 70;
/// Dimensions of three charts in a row.
const ROW_STYLE: ChartStyle = ChartStyle { size: [380.0, 250.0], margins: [56.0, 10.0, 16.0, 38.0] };

/// Returns the values for `channels.html`: charts of the examples, or the complex plane for single numbers, and the views of
/// virtual transmitters.
pub(super) fn section(run: &LoadedRun<'_>, chosen: &[Example]) -> Value {
    let data = run.data;
    let single = data.width == 1 && data.height == 2; // rows of real and imaginary parts of one antenna
    context! {
        examples => if single { Vec::new() } else { example_charts(run, chosen) },
        plane => if single { complex_plane(run) } else { None },
        over => if data.width > 1 { "subcarriers" } else { "antennas" },
        delays => subcarrier_spacing(frequencies(run)).is_some(),
        transmitters => virtual_map::transmitter_views(run),
    }
}

/// Returns the frequencies of the subcarriers, Hz.
fn frequencies<'a>(run: &LoadedRun<'a>) -> &'a [f64] {
    run.data.observations.frequencies_hz()
}

/// Creates a line with a name, with marks if they are few enough to distinguish, or if nothing joins the points.
fn marked_line(points: Vec<(f64, f64)>, colour: Colour, stroke: Stroke, marker: Marker, name: &str) -> ChartLine {
    let has_marks = points.len() <= MARKS || stroke == Stroke::None;
    let style = Style { marker: has_marks.then_some(marker), ..Style::line(colour, 1.6, stroke) };
    let marks = if has_marks { points.clone() } else { Vec::new() };
    ChartLine { marks, ..ChartLine::new(points, style) }.named(name)
}

/// Draws a chart of the measured line, solid and dark with dots, and the predicted one, dashed with crosses: print needs no
/// colour. Returns it with its title, for the template; `None` if there is nothing to draw.
fn draw_pair(title: &str, x: &str, y: &str, (measured, predicted): LinePair) -> Option<Value> {
    let lines = vec![
        marked_line(predicted, PREDICTED, Stroke::DASHED, Marker::Cross, "predicted"),
        marked_line(measured, MEASURED, Stroke::FULL, Marker::Circle, "measured"),
    ];
    let axis = |name: &str| ChartAxis { name: name.into(), ..ChartAxis::default() };
    let svg = Chart { style: ROW_STYLE, x: axis(x), y: axis(y), lines, ..Chart::default() }.draw()?.svg("chart", title);
    Some(context! { title, svg })
}

/// Draws the charts of the best, median and worst test link: magnitude, phase, and delay profile if there is one.
fn example_charts(run: &LoadedRun<'_>, chosen: &[Example]) -> Vec<Value> {
    let several = run.data.scene.receivers.len() > 1;
    let example = |example: &Example| {
        let Example { score, truth, prediction, .. } = example;
        let frequencies = frequencies(run);
        let (measured, predicted) = (Gains::of(truth), Gains::of(prediction));
        let ([magnitude, phase], along, antenna) = magnitude_and_phase(&measured, &predicted, frequencies);
        let caption = antenna.map(|k| format!("antenna {} of {} (strongest)", k + 1, measured.antennas));
        let mut charts = vec![
            draw_pair("Magnitude", &along, "dB relative to the maximum", magnitude),
            draw_pair("Phase", &along, "degrees, unwrapped", phase),
        ];
        if let Some([a, b]) = delay_profiles(&measured, &predicted, frequencies) {
            charts.push(draw_pair("Power delay profile", "delay, ns", "dB relative to the measured peak", (a, b)));
        }
        context! {
            several,
            score => number(*score),
            antenna => caption,
            charts => charts.into_iter().flatten().collect::<Vec<_>>(),
            ..example.words(run)
        }
    };
    chosen.iter().map(example).collect()
}

/// Draws at most [`DOTS`] channels of one number each on the complex plane, and joins measured dots with predicted crosses.
/// `None` without test links, or if all channels are zero or not finite.
fn complex_plane(run: &LoadedRun<'_>) -> Option<Value> {
    let (mut measured, mut predicted) = (Vec::new(), Vec::new());
    super::examples::for_each_link(run, &evenly(&run.partition.test, DOTS), |_, truth, prediction| {
        let gain = |image: &Image| (image.pixels[0] as f64, image.pixels[1] as f64);
        measured.push(gain(truth));
        predicted.push(gain(prediction));
    });
    let reach = measured.iter().chain(&predicted).flat_map(|(a, b)| [a.abs(), b.abs()]).filter(|v| v.is_finite());
    let reach = 1.08 * reach.fold(0.0, f64::max); // with a margin
    if measured.is_empty() || reach <= 0.0 {
        return None;
    }
    let mut lines = vec![
        marked_line(predicted.clone(), PREDICTED, Stroke::None, Marker::Cross, "predicted"),
        marked_line(measured.clone(), MEASURED, Stroke::None, Marker::Circle, "measured"),
    ];
    let joined = Style::line(Colour::hex(0x8d_94a1), 0.8, Stroke::FULL);
    lines.extend(measured.iter().zip(&predicted).map(|(a, b)| ChartLine::new(vec![*a, *b], joined)));
    let axis = |name: &str| ChartAxis { name: name.into(), ends: Some((-reach, reach)), log: false };
    let style = ChartStyle { size: [470.0, 450.0], ..ROW_STYLE };
    let chart = Chart { style, x: axis("real part"), y: axis("imaginary part"), lines, ..Chart::default() };
    Some(context! { svg => chart.draw()?.svg("chart", "channels on the complex plane"), links => measured.len() })
}

/// Lowest drawn level relative to the strongest, dB.
const FLOOR_DB: f64 = -60.0;

/// Channel gains, `[A, F]`.
pub(super) struct Gains {
    pub(super) antennas: usize,
    pub(super) subcarriers: usize,
    values: Vec<[f64; 2]>,
}

/// Measured and predicted line.
pub(super) type LinePair = (Vec<(f64, f64)>, Vec<(f64, f64)>);

impl Gains {
    /// Converts the rows of an observation, `[2A, F]`, to gains.
    pub(super) fn of(rows: &Image) -> Self {
        let values = gains_of(&rows.pixels, rows.width).into_iter().map(|gain| gain.map(|v| v as f64)).collect();
        Self { antennas: rows.height / 2, subcarriers: rows.width, values }
    }

    /// Returns the gains of an antenna over the subcarriers.
    pub(super) fn antenna_gains(&self, a: usize) -> &[[f64; 2]] {
        &self.values[a * self.subcarriers..][..self.subcarriers]
    }

    /// Returns the index of the antenna with the highest power over all subcarriers; the first of equal ones.
    fn strongest_antenna(&self) -> usize {
        let energy = |a: usize| self.antenna_gains(a).iter().map(power).sum::<f64>();
        (0..self.antennas).max_by(|a, b| energy(*a).total_cmp(&energy(*b)).then(b.cmp(a))).unwrap_or(0)
    }
}

/// Returns the power |h|² of a gain.
pub(super) fn power([re, im]: &[f64; 2]) -> f64 {
    re * re + im * im
}

/// Returns magnitude (dB relative to the measured maximum) and phase (degrees) of both: over the antennas for one subcarrier,
/// otherwise over the subcarriers of the strongest measured antenna. Also returns the name of the horizontal axis and the
/// index of that antenna; `None` over the antennas, or for a single one.
pub(super) fn magnitude_and_phase(
    measured: &Gains,
    predicted: &Gains,
    frequencies: &[f64],
) -> ([LinePair; 2], String, Option<usize>) {
    let over_antennas = measured.subcarriers == 1;
    let k = if over_antennas { 0 } else { measured.strongest_antenna() };
    let pick = |gains: &Gains| if over_antennas { gains.values.clone() } else { gains.antenna_gains(k).to_vec() };
    let (a, b) = (pick(measured), pick(predicted));
    let (across, words): (Vec<f64>, String) = if over_antennas {
        ((1..=a.len()).map(|n| n as f64).collect(), "antenna".into())
    } else {
        frequency_axis(frequencies)
    };
    let peak = a.iter().map(power).fold(0.0, f64::max);
    let level = |gains: &[[f64; 2]]| gains.iter().map(|gain| decibels(power(gain), peak)).collect::<Vec<_>>();
    let (phase_a, phase_b) = (unwrapped_phases(&a, None), unwrapped_phases(&b, a.first().map(phase_deg)));
    let on = |values: Vec<f64>| across.iter().copied().zip(values).collect::<Vec<_>>();
    (
        [(on(level(&a)), on(level(&b))), (on(phase_a), on(phase_b))],
        words,
        (!over_antennas && measured.antennas > 1).then_some(k),
    )
}

/// Returns the differences of frequencies in Hz from their mean, in kHz within 1 MHz and otherwise in MHz, and the name of
/// their axis.
fn frequency_axis(frequencies: &[f64]) -> (Vec<f64>, String) {
    let middle = frequencies.iter().sum::<f64>() / frequencies.len().max(1) as f64;
    let span = frequencies.iter().map(|f| (f - middle).abs()).fold(0.0, f64::max);
    let (unit, name) = if span < 1e6 { (1e3, "kHz") } else { (1e6, "MHz") };
    let words = format!("{name} from {:.3} MHz", middle / 1e6);
    (frequencies.iter().map(|f| (f - middle) / unit).collect(), words)
}

/// Returns the ratio of two powers in decibels, at least [`FLOOR_DB`], which is also returned if the reference is 0.
pub(super) fn decibels(power: f64, reference: f64) -> f64 {
    if reference > 0.0 { (10.0 * (power / reference).log10()).max(FLOOR_DB) } else { FLOOR_DB }
}

/// Returns the phase of a gain, degrees.
fn phase_deg([re, im]: &[f64; 2]) -> f64 {
    im.atan2(*re).to_degrees()
}

/// Returns the unwrapped phases, degrees: no jump exceeds half a turn; the first is as close to `from` (`None`: 0) as whole
/// turns allow.
fn unwrapped_phases(gains: &[[f64; 2]], from: Option<f64>) -> Vec<f64> {
    let near = |phase: f64, last: f64| phase + 360.0 * ((last - phase) / 360.0).round();
    let unwrap = |last: &mut f64, gain| {
        *last = near(phase_deg(gain), *last);
        Some(*last)
    };
    gains.iter().scan(from.unwrap_or(0.0), unwrap).collect()
}

/// Minimum number of subcarriers for a delay profile.
const FEWEST: usize = 4;
/// Points along the delay axis per subcarrier.
const FINE: usize = 4;
/// Part of all delays that is drawn before 0, as a divisor.
const BEFORE: usize = 6;
/// Maximum number of points along the delay axis.
const MOST_DELAYS: usize = 2_048;

/// Returns the subcarrier spacing, Hz; `None` for fewer than [`FEWEST`] or unequally spaced subcarriers.
pub(super) fn subcarrier_spacing(frequencies: &[f64]) -> Option<f64> {
    let step = (frequencies.last()? - frequencies.first()?) / (frequencies.len().max(2) - 1) as f64;
    let is_even = frequencies.windows(2).all(|pair| (pair[1] - pair[0] - step).abs() < 1e-3 * step.abs());
    (frequencies.len() >= FEWEST && is_even && step.is_finite() && step != 0.0).then_some(step.abs())
}

/// Returns the power delay profiles, measured and predicted: inverse Fourier transform over subcarriers, power summed
/// over antennas. Delay in ns, power in dB relative to the measured peak. `None` without a [`subcarrier_spacing`].
pub(super) fn delay_profiles(measured: &Gains, predicted: &Gains, frequencies: &[f64]) -> Option<[Vec<(f64, f64)>; 2]> {
    let step = subcarrier_spacing(frequencies)?;
    let forward = frequencies.first() <= frequencies.last();
    let delays = (FINE * frequencies.len()).min(MOST_DELAYS);
    let power = |gains: &Gains| -> Vec<f64> {
        let at =
            |index: usize| (0..gains.antennas).map(|a| tap_power(gains.antenna_gains(a), index, delays, forward)).sum();
        (0..delays).map(at).collect()
    };
    let (measured, predicted) = (power(measured), power(predicted));
    let peak = measured.iter().copied().fold(0.0, f64::max);
    // The end of the period is drawn before 0, so that a path at 0 is complete.
    let before = delays / BEFORE;
    let line = |powers: Vec<f64>| {
        let delay = |k: usize| 1e9 * (k as f64 - before as f64) / (delays as f64 * step);
        (0..delays).map(|k| (delay(k), decibels(powers[(k + delays - before) % delays], peak))).collect()
    };
    Some([line(measured), line(predicted)])
}

/// Returns |Σ h w exp(j 2π k `index`/`count`)|² with a raised-cosine window w, which keeps one path from masking all
/// others. The exponent is negative unless the frequencies run `forward`.
fn tap_power(gains: &[[f64; 2]], index: usize, count: usize, forward: bool) -> f64 {
    let subcarriers = gains.len() as f64;
    let sum = gains.iter().enumerate().fold([0.0; 2], |[x, y], (k, [re, im])| {
        let weight = 0.5 - 0.5 * (TAU * (k as f64 + 0.5) / subcarriers).cos();
        let turn = TAU * (k * index % count) as f64 / count as f64;
        let (sin, cos) = (if forward { turn } else { -turn }).sin_cos();
        [x + weight * (re * cos - im * sin), y + weight * (re * sin + im * cos)]
    });
    power(&sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unwraps_phases_and_limits_decibels() {
        let turning: Vec<[f64; 2]> =
            (0..5).map(|k| f64::from(150 * k).to_radians().sin_cos()).map(|(sin, cos)| [cos, sin]).collect();
        let phases = unwrapped_phases(&turning, None);
        assert!(phases.iter().zip([0.0, 150.0, 300.0, 450.0, 600.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{phases:?}");
        assert!((unwrapped_phases(&turning, Some(350.0))[0] - 360.0).abs() < 1e-9);
        assert_eq!((decibels(0.0, 1.0), decibels(1.0, 0.0)), (FLOOR_DB, FLOOR_DB));
    }

    #[test]
    fn one_subcarrier_is_drawn_over_antennas() {
        let rows = |v: f32| Image { width: 1, height: 4, pixels: [v, 0.0, 0.0, 2.0 * v].map(|v| v as _).to_vec() };
        let (lines, along, antenna) = magnitude_and_phase(&Gains::of(&rows(1.0)), &Gains::of(&rows(0.0)), &[1e9]);
        assert_eq!((along.as_str(), antenna, lines[0].0.len()), ("antenna", None, 2));
        assert_eq!(lines[0].0[1], (2.0, 0.0));
    }

    #[test]
    fn delay_profile_of_one_path_peaks_at_its_delay() {
        let delay_s = 100e-9;
        let frequencies: Vec<f64> = (0..16).map(|k| 2.4e9 + 1.25e6 * f64::from(k)).collect();
        let phases: Vec<f64> = frequencies.iter().map(|f| -TAU * f * delay_s).collect();
        let parts = phases.iter().map(|p| p.cos()).chain(phases.iter().map(|p| p.sin()));
        let gains = Gains::of(&Image { width: 16, height: 2, pixels: parts.map(|v| v as _).collect() });
        let [profile, same] = delay_profiles(&gains, &gains, &frequencies).unwrap();
        let peak = profile.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((peak.0 - 100.0).abs() < 13.0 && peak.1.abs() < 1e-9, "{peak:?}");
        assert_eq!(profile, same);
    }

    #[test]
    fn delay_profile_requires_uniform_subcarriers() {
        assert_eq!(subcarrier_spacing(&[1e9, 2e9, 3e9, 4e9]), Some(1e9));
        for none in [&[][..], &[1e9], &[1e9, 2e9, 3e9], &[1e9, 2e9, 3e9, 9e9], &[1e9; 5]] {
            assert_eq!(subcarrier_spacing(none), None, "{none:?}");
        }
    }
}

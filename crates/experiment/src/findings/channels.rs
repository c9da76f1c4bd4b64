//! Checks of channels: zeros, numbers without phase, spacing of antennas, sign of time, coherence of the snapshots.
//!
//! A path of length d has the phase −kd. Channels times exp(jkd) of the direct path are equal at all positions, up to
//! other paths, if the snapshots are synchronised. A constant response of each antenna and subcarrier has no effect on the
//! comparison of positions. Times exp(−jkd) instead, conjugated channels become equal.

use super::finding::Finding;
use crate::text::format_length;
use glam::{DVec2, DVec3};
use pwrfgs_core::neighbours::{distance, nearest_others};
use pwrfgs_core::statistics::median;
use pwrfgs_core::{Channels, Dataset, MeasurementSetup, Observations, Real, SPEED_OF_LIGHT, carrier_fault, evenly};
use std::f64::consts::TAU;

/// Distance between neighbouring antennas above which they are probably in another unit, wavelengths.
const APART: f64 = 10.0;
/// Smallest number of snapshots for a verdict on phases, and largest number of gains that are compared.
const FEWEST: usize = 40;
const MOST_GAINS: usize = 4_000_000;
/// Factor over the coherence of random phases above which snapshots are coherent: of all positions, and of nearest ones.
const ABOVE_RANDOM: [f64; 2] = [10.0, 3.0];
/// Ratio above which one sign of time fits better.
const BETTER: f64 = 4.0;
/// Share of power in a direct path that is visible within each snapshot, and its ratio to that of the other sign.
const VISIBLE: [f64; 2] = [0.5, 1.5];
/// Step between positions below which neighbouring channels are alike, wavelengths.
const NEAR: f64 = 0.25;
const POWERS: &str = "use powers per subcarrier (`pwrfgs import --channels FILE --powers ..`)";

/// Finds implausible channels; empty for other observations.
pub(super) fn check_channels(data: &Dataset) -> Vec<Finding> {
    let Observations::Channels(channels) = &data.observations else { return Vec::new() };
    let setup = MeasurementSetup::of(data, data.plane());
    let hz = setup.frequencies_of(0);
    let carrier_hz = hz.iter().sum::<f64>() / hz.len() as f64;
    let carrier = carrier_fault(carrier_hz).map(|fault| Finding::new("carrier", data.len(), fault, "correct it"));
    let phases = PhaseCheck::of(data).and_then(|phases| phases.finding());
    let antennas = check_antennas(data, SPEED_OF_LIGHT / carrier_hz);
    [carrier, check_zeros(data, channels), check_values(channels), antennas, phases].into_iter().flatten().collect()
}

/// Finds zero channels, in the data or left out when they were read; `None` without any.
fn check_zeros(data: &Dataset, channels: &Channels) -> Option<Finding> {
    let left_out = data.unmatched.positions; // readers of channels count zero ones here
    let problem = format!("{left_out} of {} channels are zero, not received, and are left out", data.len() + left_out);
    if left_out > 0 {
        return Some(Finding::new("zero-channels", left_out, problem, "check that these positions have no signal"));
    }
    let zeros = (0..data.len()).filter(|i| channels.of(*i).iter().all(|gain| *gain == [0.0; 2])).count();
    let problem = format!("{zeros} of {} channels are zero, as if not received", data.len());
    (zeros > 0).then(|| Finding::new("zero-channels", zeros, problem, "leave them out"))
}

/// Finds channels without imaginary parts; `None` if any imaginary part is not 0.
fn check_values(channels: &Channels) -> Option<Finding> {
    let any = |is: fn(&[Real; 2]) -> bool| channels.gains.iter().any(is);
    let (kind, mend) = match (any(|[re, _]| *re < 0.0), any(|[re, _]| *re > 0.0)) {
        _ if any(|[_, im]| *im != 0.0) => return None,
        (true, true) => ("real parts alone", "save real + 1j * imaginary parts"),
        (true, false) => ("levels in dB, which have no phase", POWERS),
        (false, _) => ("amplitudes, which have no phase", POWERS),
    };
    let problem = format!("all imaginary parts are 0: these are {kind}");
    Some(Finding::new("channel-phase", channels.gains.len() / channels.of(0).len(), problem, mend))
}

/// Finds antennas of the first receiver that are far from all others, for a `wavelength` in metres; `None` without any.
fn check_antennas(data: &Dataset, wavelength: f64) -> Option<Finding> {
    let antennas = &data.scene.receivers[0].antennas;
    let nearest =
        |a: &[f64; 3]| antennas.iter().map(|b| distance(*a, *b)).filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min);
    let gaps = antennas.iter().map(nearest).filter(|gap| gap.is_finite() && *gap > APART * wavelength);
    let (count, gap) = gaps.fold((0, 0.0_f64), |(count, widest), gap| (count + 1, gap.max(widest)));
    let problem =
        format!("{count} antennas are up to {gap:.2} m from the nearest other, {:.0} wavelengths", gap / wavelength);
    let mend = "if their positions are in millimetres or centimetres, convert them to metres";
    (count > 0).then(|| Finding::new("antenna-spacing", count, problem, mend))
}

/// Coherence of channels after removal of the delay of the direct path, by one sign of time; 1 if all are equal.
#[derive(Clone, Copy, Debug)]
struct Coherence {
    /// Mean of all pairs of positions: the share of power in one direct path.
    all: f64,
    /// Mean of each position and the nearest other.
    near: f64,
    /// Mean share of power of the direct path within each snapshot, without comparison of snapshots.
    within: f64,
}

/// Comparison of channels of the first receiver with its direct path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PhaseCheck {
    count: usize,
    /// For the sign of time exp(−jkd), and for the other.
    fits: [Coherence; 2],
    /// Median distance from a position to the nearest other, metres.
    step_m: f64,
    /// The same distance in wavelengths of the carrier.
    step_wavelengths: f64,
}

impl PhaseCheck {
    /// Compares the received snapshots; of more than [`MOST_GAINS`] gains in all, evenly chosen ones, at least [`FEWEST`]. `None`
    /// for other observations, unknown positions, links with features, gains without phase, or fewer received snapshots.
    pub(crate) fn of(data: &Dataset) -> Option<Self> {
        let Observations::Channels(channels) = &data.observations else { return None };
        let is_known = data.placed && data.features.is_none() && data.scene.has_distances();
        if !is_known || check_values(channels).is_some() {
            return None;
        }
        let is_received = |i: &usize| channels.of(*i).iter().any(|gain| *gain != [0.0; 2]);
        let links: Vec<usize> = (0..data.len()).filter(|i| data.links[*i].receiver == 0 && is_received(i)).collect();
        let links = evenly(&links, (MOST_GAINS / channels.of(0).len()).max(FEWEST));
        if links.len() < FEWEST {
            return None;
        }
        let hz = MeasurementSetup::of(data, data.plane()).frequencies_of(0);
        let snapshots: Vec<Snapshot<'_>> = links.iter().map(|i| Snapshot::of(data, channels, *i)).collect();
        let positions: Vec<[f64; 3]> = snapshots.iter().map(|snapshot| snapshot.position).collect();
        let nearest: Vec<(f64, usize)> =
            nearest_others(&positions).into_iter().map(Option::unwrap_or_default).collect();
        let step_m = median(nearest.iter().map(|(distance, _)| *distance));
        let fits = Coherence::of(&snapshots, &hz, &nearest);
        let carrier_hz = hz.iter().sum::<f64>() / hz.len() as f64;
        Some(Self { count: links.len(), fits, step_m, step_wavelengths: step_m * carrier_hz / SPEED_OF_LIGHT })
    }

    /// Returns the index in `fits` of the sign of time that fits clearly: 0 for that of this program, 1 for the conjugate. `None`
    /// if undecided.
    fn sign(&self) -> Option<usize> {
        let is_coherent = |fit: Coherence| fit.all > ABOVE_RANDOM[0] / self.count as f64;
        (0..2).find(|k| is_coherent(self.fits[*k]) && self.fits[*k].all > BETTER * self.fits[1 - k].all)
    }

    /// Returns whether snapshots are no more alike than those with random phases.
    fn is_incoherent(&self) -> bool {
        let [all, near] = [ABOVE_RANDOM[0] / self.count as f64, ABOVE_RANDOM[1] / (self.count as f64).sqrt()];
        self.fits.iter().all(|fit| fit.all < all && fit.near < near)
    }

    /// Returns the finding on conjugated or unsynchronised channels; `None` if they are plausible or undecided.
    fn finding(&self) -> Option<Finding> {
        let [plain, conjugate] = self.fits;
        if self.sign() == Some(1) {
            let [all, other] = [plain.all, conjugate.all].map(|share| 100.0 * share);
            let share =
                format!("the direct path has {other:.0} % of its power, but {all:.0} % of that of the channels");
            let problem = format!("the conjugate fits better: {share}");
            return Some(Finding::new("conjugate", self.count, problem, "save numpy.conj of the channels"));
        }
        let (high, low) = (plain.within.max(conjugate.within), plain.within.min(conjugate.within));
        // Phases of distant positions differ in any case, unless the direct path is visible.
        let is_decided = self.step_wavelengths < NEAR || high > VISIBLE[0] && high > VISIBLE[1] * low;
        let problem =
            "the phases of neighbouring positions are not coherent, as of a chip that does not synchronise snapshots";
        let mend = format!("{POWERS}; if the snapshots are synchronised, check positions, antennas and carrier");
        (self.is_incoherent() && is_decided).then(|| Finding::new("phase-coherence", self.count, problem, mend))
    }

    /// Describes the fit of both signs of time, and the coherence of nearest positions.
    pub(crate) fn describe(&self) -> String {
        let best = self.sign().unwrap_or_default();
        let verdict = match self.sign() {
            Some(0) => "the sign of time fits".to_owned(),
            Some(_) => "the conjugate fits better; numpy.conj mends it".into(),
            None if self.is_incoherent() => {
                format!("not coherent; if the chip does not synchronise snapshots, {POWERS}")
            }
            None => "the sign of time is undecided".into(),
        };
        let [all, other] = self.fits.map(|fit| 100.0 * fit.all);
        let (near, step) = (self.fits[best].near, format_length(self.step_m));
        let share = format!("the direct path has {all:.0} % of the power, {other:.0} % in the conjugate");
        format!("{verdict}: {share}; coherence {near:.2} between nearest positions (median {step})")
    }
}

/// Channel of one position: a view of the data, because copies of all would double their memory.
struct Snapshot<'a> {
    position: [f64; 3],
    /// Gains `[A,F]`, and the root of their energy.
    gains: &'a [[Real; 2]],
    size: f64,
    /// Distance to each antenna `[A]`, metres.
    distances: Vec<f64>,
}

impl<'a> Snapshot<'a> {
    /// Creates the snapshot of link `i`, which is at the first receiver.
    fn of(data: &Dataset, channels: &'a Channels, i: usize) -> Self {
        let [transmitter, receiver] = data.link_ends(i);
        let distance_to = |antenna: &[f64; 3]| {
            let from = DVec3::from_array(receiver.position) + DVec3::from_array(receiver.turned(*antenna));
            from.distance(DVec3::from_array(transmitter.position))
        };
        let (position, gains) = (data.sample(i).position(), channels.of(i));
        let size = gains.iter().map(|gain| vector(gain).length_squared()).sum::<f64>().sqrt();
        Self { position, gains, size, distances: data.scene.receivers[0].antennas.iter().map(distance_to).collect() }
    }

    /// Returns the gains `[A,F]`, scaled to unit energy, after removal of the delay of the direct path, by both signs of time.
    fn aligned_gains<'b>(&'b self, hz: &'b [f64]) -> impl Iterator<Item = [DVec2; 2]> + 'b {
        let phase = |i: usize| TAU * hz[i % hz.len()] * self.distances[i / hz.len()] / SPEED_OF_LIGHT;
        self.gains.iter().enumerate().map(move |(i, gain)| {
            let (wave, gain) = (DVec2::from_angle(phase(i)), vector(gain) / self.size);
            [wave, conjugate(wave)].map(|wave| wave.rotate(gain))
        })
    }
}

/// Returns a gain as the vector of its real and imaginary part.
fn vector(gain: &[Real; 2]) -> DVec2 {
    DVec2::from_array(gain.map(|v| v as f64))
}

/// Returns the complex conjugate.
fn conjugate(v: DVec2) -> DVec2 {
    DVec2::new(v.x, -v.y)
}

impl Coherence {
    /// Computes the coherence of the snapshots by both signs of time. `nearest` holds distance and index of the nearest other
    /// of each; `hz` the frequencies `[F]`.
    fn of(snapshots: &[Snapshot<'_>], hz: &[f64], nearest: &[(f64, usize)]) -> [Self; 2] {
        let (count, width) = (snapshots.len() as f64, snapshots[0].gains.len());
        let mut totals = vec![[DVec2::ZERO; 2]; width];
        let (mut within, mut near) = ([0.0; 2], [DVec2::ZERO; 2]);
        for (snapshot, (_, other)) in snapshots.iter().zip(nearest) {
            let (mut sums, mut products) = ([DVec2::ZERO; 2], [DVec2::ZERO; 2]);
            let pairs = snapshot.aligned_gains(hz).zip(snapshots[*other].aligned_gains(hz));
            for (total, (a, b)) in totals.iter_mut().zip(pairs) {
                for sign in 0..2 {
                    total[sign] += a[sign];
                    sums[sign] += a[sign];
                    products[sign] += conjugate(a[sign]).rotate(b[sign]);
                }
            }
            for sign in 0..2 {
                within[sign] += sums[sign].length_squared();
                near[sign] += products[sign];
            }
        }
        [0, 1].map(|sign| Self {
            all: totals.iter().map(|total| total[sign].length_squared()).sum::<f64>() / count.powi(2),
            near: near[sign].length() / count,
            within: within[sign] / (count * width as f64),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Receiver, Sample, rng};

    /// 60 channels of three antennas and eight subcarriers, with a direct path and a reflection, of synchronised snapshots if
    /// `phase` is 0; `change` applies to each gain.
    fn data(phase: f64, change: impl Fn(usize, DVec2) -> DVec2) -> Dataset {
        let mut random = rng::stream(1, "channels", 0);
        let uniform = |random: &mut rng::Rng| rng::uniform_f64(random);
        let hz: Vec<f64> = (0..8).map(|f| 2.437e9 + 2.5e6 * f64::from(f)).collect();
        let antennas = [-0.06, 0.0, 0.06].map(|x| [x, 0.0, 0.0]);
        let receiver = Pose { position: [0.0, 0.0, 2.0], ..Pose::IDENTITY };
        let (mut samples, mut gains) = (Vec::new(), Vec::new());
        for id in 0..60_u32 {
            let p = [1.0 + 4.0 * uniform(&mut random), 1.0 + 3.0 * uniform(&mut random), 1.2];
            samples.push(Sample::new(id, p));
            let turn = DVec2::from_angle(phase * TAU * uniform(&mut random));
            for antenna in antennas {
                let path = |y: f64| distance(p, [antenna[0], y, 2.0]);
                for f in &hz {
                    let wave = |d: f64| DVec2::from_angle(-TAU * f * d / SPEED_OF_LIGHT) / d;
                    let gain = change(id as usize, turn.rotate(wave(path(0.0)) + 0.5 * wave(path(-6.0))));
                    gains.push([gain.x as Real, gain.y as Real]);
                }
            }
        }
        let receiver = Receiver { antennas: antennas.to_vec(), ..Receiver::new("ap", receiver) };
        let channels = Channels { antennas: 3, frequencies_hz: hz, gains };
        Dataset::of_links("room", vec![receiver], vec![], &samples, channels.into()).unwrap()
    }

    fn found(data: &Dataset) -> Vec<String> {
        check_channels(data).iter().map(ToString::to_string).collect()
    }

    #[test]
    fn right_channels_have_no_finding() {
        let data = data(0.0, |_, gain| gain);
        assert_eq!(found(&data), Vec::<String>::new());
        let text = PhaseCheck::of(&data).unwrap().describe();
        assert!(text.starts_with("the sign of time fits: the direct path has "), "{text}");
        assert!(PhaseCheck::of(&data.subset(&(0..39).collect::<Vec<_>>()).unwrap()).is_none(), "too few");
    }

    #[test]
    fn conjugated_channels_are_mended_by_conj() {
        let data = data(0.0, |_, gain| DVec2::new(gain.x, -gain.y));
        let found = found(&data);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].starts_with("conjugate: the conjugate fits better: the direct path has "), "{found:?}");
        assert!(found[0].ends_with("; save numpy.conj of the channels"), "{found:?}");
        assert!(
            PhaseCheck::of(&data).unwrap().describe().starts_with("the conjugate fits better; numpy.conj mends it")
        );
    }

    #[test]
    fn unsynchronised_channels_are_offered_powers() {
        for conjugate in [1.0, -1.0] {
            let data = data(1.0, |_, gain| DVec2::new(gain.x, conjugate * gain.y));
            let found = found(&data);
            assert_eq!(found.len(), 1, "{found:?}");
            assert!(found[0].starts_with("phase-coherence: "), "{found:?}");
            assert!(found[0].contains("use powers per subcarrier (`pwrfgs import --channels FILE --powers ..`)"));
            assert!(PhaseCheck::of(&data).unwrap().describe().starts_with("not coherent; if the chip"));
        }
    }

    #[test]
    fn finds_values_without_phase_and_zeros() {
        let of = |change: fn(usize, DVec2) -> DVec2| found(&data(0.0, change)).join("\n");
        let amplitudes = of(|_, gain| DVec2::new(gain.length(), 0.0));
        assert!(
            amplitudes.starts_with("channel-phase: all imaginary parts are 0: these are amplitudes"),
            "{amplitudes}"
        );
        let decibels = of(|_, gain| DVec2::new(20.0 * (gain.length() / 10.0).log10(), 0.0));
        assert!(decibels.contains("these are levels in dB, which have no phase; use powers"), "{decibels}");
        let real = of(|_, gain| DVec2::new(gain.x, 0.0));
        assert_eq!(check_channels(&data(0.0, |_, gain| DVec2::new(gain.x, 0.0)))[0].count, 60, "channels, not gains");
        assert!(real.contains("these are real parts alone; save real + 1j * imaginary parts"), "{real}");
        let zeros = of(|id, gain| if id % 4 == 0 { DVec2::ZERO } else { gain });
        assert_eq!(zeros, "zero-channels: 15 of 60 channels are zero, as if not received; leave them out");
        assert!([amplitudes, decibels, real].iter().all(|text| !text.contains('\n')));
    }

    #[test]
    fn finds_antennas_in_another_unit_and_carriers_out_of_range() {
        let mut wide = data(0.0, |_, gain| gain);
        wide.scene.receivers[0].antennas.iter_mut().flatten().for_each(|x| *x *= 1000.0);
        let text = found(&wide).join("\n");
        assert!(
            text.starts_with("antenna-spacing: 3 antennas are up to 60.00 m from the nearest other, 489 "),
            "{text}"
        );
        let mut low = data(0.0, |_, gain| gain);
        let Observations::Channels(channels) = &mut low.observations else { unreachable!() };
        channels.frequencies_hz.iter_mut().for_each(|hz| *hz /= 1e6);
        assert!(found(&low)[0].starts_with("carrier: the carrier is 244"), "{:?}", found(&low));
    }
}

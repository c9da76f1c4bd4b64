//! Check of the recorded pose: geometric line of sight compared with the strongest direction.
//!
//! If most transmitters are received strongest along the direct path, the strongest directions of spectra are the lines of
//! sight in the receiver's frame, up to one rotation: the error of the recorded orientation. The rotation that fits best
//! is compared with one constant direction, which ignores the transmitter.
//!
//! Wahba's problem, max over R of Σ w bᵀRa, is the largest eigenvector of a symmetric 4 x 4 matrix (Davenport's
//! q-method). With weights 1/angle, updated iteratively, the result minimises the sum of angles: reflections that are
//! stronger than the direct path then have little influence.

use super::spectra::SpectrumSummary;
use glam::{DMat3, DMat4, DQuat, DVec3};
use pwrfgs_core::{AngleAxis, Dataset, ImagePlane, evenly, statistics};

/// Largest number of compared pairs.
const PAIRS: usize = 4_000;
/// Smallest number of pairs for a verdict.
const FEWEST: usize = 20;

/// Comparison of lines of sight with strongest directions; angles in degrees, medians over spectra.
#[derive(Clone, Debug)]
pub struct PoseCheck {
    /// Number of transmitters whose strongest direction was compared.
    pub pairs: usize,
    /// Angle between line of sight and strongest direction, by the recorded pose.
    pub recorded: f64,
    /// Angle after the best rotation.
    pub turned: f64,
    /// Angle between the strongest direction and the constant direction that fits best.
    pub constant: f64,
    /// Angle of the best rotation.
    pub turn: f64,
    /// Orientation x, y, z, w after the best rotation of the recorded one.
    pub orientation: [f64; 4],
    /// Angle of lines of sight from their mean direction.
    pub spread: f64,
    /// Alternative interpretations of the recorded numbers, with the angle.
    readings: Vec<(&'static str, f64)>,
    /// Spectra with reversed columns or rows, with the angle after the best rotation.
    flips: Vec<(Flip, f64)>,
    /// Conclusion.
    pub verdict: PoseVerdict,
}

/// Checks the recorded pose; `None` if fewer than twenty spectra have a strongest direction, or the receiver moves.
pub(super) fn check_pose(data: &Dataset, spectra: &[SpectrumSummary]) -> Option<PoseCheck> {
    if data.orientations.is_some() {
        return None;
    }
    // The first of several receivers; each has its own pose.
    let receiver = data.scene.origin.world_pose(data.scene.pose());
    let pair = |spectrum: &SpectrumSummary| {
        let sample = data.sample(spectrum.sample);
        let sight = DVec3::from_array(sample.tx) - DVec3::from_array(receiver.position);
        if sample.receiver != 0 {
            return None;
        }
        Some((sight.try_normalize()?, spectrum.strongest?))
    };
    let in_world: Vec<DirectionPair> = evenly(&spectra.iter().filter_map(pair).collect::<Vec<_>>(), PAIRS);
    if in_world.len() < FEWEST {
        return None;
    }
    let [x, y, z, w] = receiver.orientation;
    let recorded = DQuat::from_xyzw(x, y, z, w).normalize();
    let with = |world_from_receiver: DQuat| -> Vec<DirectionPair> {
        in_world.iter().map(|(sight, strongest)| (world_from_receiver.inverse() * *sight, *strongest)).collect()
    };
    let other_order = DQuat::from_xyzw(y, z, w, x).normalize();
    let readings = [
        ("x, y, z, w, turned the other way (receiver from world)", recorded.inverse()),
        ("w, x, y, z", other_order),
        ("w, x, y, z, turned the other way", other_order.inverse()),
    ];
    let pairs = with(recorded);
    let correction = best(&pairs);
    let (sights, strongest): (Vec<DVec3>, Vec<DVec3>) = pairs.iter().copied().unzip();
    let spread = |directions: &[DVec3]| {
        let middle = middle(directions);
        median_deg(directions.iter().map(|d| angle(middle, *d)))
    };
    let mut found = PoseCheck {
        pairs: pairs.len(),
        recorded: median(&pairs, DQuat::IDENTITY),
        turned: median(&pairs, correction),
        constant: spread(&strongest),
        turn: correction.angle_between(DQuat::IDENTITY).to_degrees(),
        orientation: (recorded * correction.inverse()).normalize().to_array(),
        spread: spread(&sights),
        readings: readings.map(|(name, taken)| (name, median(&with(taken), DQuat::IDENTITY))).into(),
        flips: flips(&data.plane(), &pairs),
        verdict: PoseVerdict::Right,
    };
    found.verdict = PoseVerdict::of(&found);
    Some(found)
}

/// Reversed columns and rows, with the best orientation.
fn flips(plane: &ImagePlane, pairs: &[DirectionPair]) -> Vec<(Flip, f64)> {
    let Some((azimuth, elevation)) = plane.angles else { return Vec::new() };
    // The last pixel takes the position of the first.
    let ends = |axis: AngleAxis, count: usize| (2.0 * axis.first + axis.step * (count as f64 - 1.0)).to_radians();
    let (across, up) = (ends(azimuth, plane.width), ends(elevation, plane.height));
    let flip = |d: DVec3, is_rows: bool| {
        let (a, e) = (d.y.atan2(d.x), d.z.atan2(d.x.hypot(d.y)));
        let (a, e) = if is_rows { (a, up - e) } else { (across - a, e) };
        DVec3::new(e.cos() * a.cos(), e.cos() * a.sin(), e.sin())
    };
    let angle = |which: Flip, is_rows: bool| {
        let pairs: Vec<DirectionPair> =
            pairs.iter().map(|(sight, strongest)| (*sight, flip(*strongest, is_rows))).collect();
        (which, median(&pairs, best(&pairs)))
    };
    vec![angle(COLUMNS, false), angle(ROWS, true)]
}

/// Median angle of `pairs` after rotating the first direction of each, degrees.
fn median(pairs: &[DirectionPair], turn: DQuat) -> f64 {
    median_deg(pairs.iter().map(|(a, b)| angle(turn * *a, *b)))
}

fn median_deg(angles: impl Iterator<Item = f64>) -> f64 {
    statistics::median(angles.map(f64::to_degrees))
}

/// Conclusion about the recorded pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseVerdict {
    /// A rotation gives no improvement.
    Right,
    /// The strongest direction follows the line of sight, once the receiver is turned.
    Off,
    /// The strongest direction follows the line of sight, once rows or columns of the spectra are reversed.
    Flipped,
    /// A rotation fits better, but hardly better than one constant direction.
    Unclear,
    /// The strongest direction does not follow the line of sight, turned or not.
    NotDirect,
}

/// Largest rotation within the precision of the strongest pixel, degrees.
const SMALL_DEG: f64 = 2.0;
/// Largest ratio of remaining angle to the angle of a constant direction for which the strongest direction follows the
/// line of sight.
const FOLLOWS: f64 = 0.6;
/// Angle above which the strongest direction is not the line of sight, degrees.
const WIDE_DEG: f64 = 20.0;
/// Name of a flip of the spectra, and its correction.
type Flip = (&'static str, &'static str);
const COLUMNS: Flip = ("columns reversed (azimuth the other way)", "save the spectra as s[:, :, ::-1]");
const ROWS: Flip = (
    "rows reversed (elevation counts the other way)",
    "exchange the two numbers of `elevation`, or save the spectra as s[:, ::-1, :]",
);

impl PoseVerdict {
    fn of(found: &PoseCheck) -> Self {
        if found.flip().is_some() {
            return Self::Flipped;
        }
        let agrees = found.turn <= SMALL_DEG || found.recorded <= 1.15 * found.turned + 0.5;
        match (found.follows(), agrees) {
            (true, true) => Self::Right,
            (true, false) => Self::Off,
            (false, true) if found.recorded <= SMALL_DEG => Self::Right,
            (false, _) if found.turned.min(found.constant) > WIDE_DEG => Self::NotDirect,
            (false, _) => Self::Unclear,
        }
    }

    /// Verdict in one sentence.
    pub fn title(self) -> &'static str {
        match self {
            Self::Right => "The recorded orientation fits the spectra.",
            Self::Off => "The recorded orientation does not fit the spectra; another one does.",
            Self::Flipped => "Rows or columns of the spectra run the other way.",
            Self::Unclear => "The spectra cannot tell whether the recorded orientation is right.",
            Self::NotDirect => {
                "The strongest direction does not follow the transmitter: reflections are stronger than the direct path, or \
                 positions or axes of the spectra are wrong."
            }
        }
    }
}

impl PoseCheck {
    fn follows(&self) -> bool {
        self.turned <= FOLLOWS * self.constant
    }

    /// Angles and conclusion as sentences.
    pub fn sentences(&self) -> Vec<String> {
        let Self { recorded, turned, constant, turn, spread, pairs, .. } = self;
        let [x, y, z, w] = self.orientation;
        let mut all = vec![format!(
            "The strongest direction is {recorded:.1}° from the geometric line of sight (median of {pairs} spectra). The best \
             rotation turns the receiver by {turn:.1}° and leaves {turned:.1}°; one constant direction for all transmitters leaves {constant:.1}°."
        )];
        match self.verdict {
            PoseVerdict::Off => all.push(format!(
                "The recorded orientation is wrong or its numbers have another meaning. This orientation fits: [{x:.6}, \
                 {y:.6}, {z:.6}, {w:.6}] (x, y, z, w)."
            )),
            PoseVerdict::Right | PoseVerdict::Unclear if !self.follows() => all.push(format!(
                "Transmitters are seen within {spread:.1}° of one direction (median), so a wrong orientation and a strongest \
                 path that is not direct look alike. Spectra of transmitters at known positions, 30° or more apart and in \
                 line of sight, would tell."
            )),
            _ => {}
        }
        if let Some(((name, advice), angle)) = self.flip() {
            all.push(format!("With {name} and the rotation that then fits best the angle is {angle:.1}°: {advice}."));
        }
        if let Some((name, angle)) = self.better_reading() {
            all.push(format!("If the recorded numbers are {name}, the angle is {angle:.1}°."));
        }
        all
    }

    /// Interpretation of the recorded numbers that fits much better than the documented one.
    fn better_reading(&self) -> Option<(&'static str, f64)> {
        let limit = (0.5 * self.recorded).min(1.5 * self.turned);
        self.readings.iter().filter(|(_, angle)| *angle < limit).min_by(|a, b| a.1.total_cmp(&b.1)).copied()
    }

    /// Best flip, if it fits much better than any rotation.
    fn flip(&self) -> Option<&(Flip, f64)> {
        let limit = (0.5 * self.turned.min(self.recorded)).min(FOLLOWS * self.constant);
        self.flips.iter().filter(|(_, angle)| *angle < limit).min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// Smallest angle in the weights, radians: about a pixel.
const LEAST: f64 = 0.01;
/// Number of reweighting iterations.
const ROUNDS: usize = 40;
/// Number of matrix squarings, which separate eigenvalues with a relative difference of 10⁻⁹.
const SQUARINGS: usize = 36;

/// Two directions that should coincide.
type DirectionPair = (DVec3, DVec3);

/// Angle between two unit vectors, radians; accurate for small angles, unlike the arc cosine.
fn angle(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b))
}

/// Rotation R with the smallest Σ angle(R a, b).
fn best(pairs: &[DirectionPair]) -> DQuat {
    let cost = |r: &DQuat| pairs.iter().map(|(a, b)| angle(*r * *a, *b)).sum::<f64>();
    // Two starts: no rotation, and the least-squares rotation.
    let [a, b] = [DQuat::IDENTITY, wahba(pairs, &vec![1.0; pairs.len()])].map(|start| refined(start, pairs));
    if cost(&b) < cost(&a) { b } else { a }
}

fn refined(mut rotation: DQuat, pairs: &[DirectionPair]) -> DQuat {
    for _ in 0..ROUNDS {
        let weights: Vec<f64> = pairs.iter().map(|(a, b)| 1.0 / angle(rotation * *a, *b).max(LEAST)).collect();
        let next = wahba(pairs, &weights);
        let change = next.angle_between(rotation);
        rotation = next;
        if change < 1e-6 {
            break;
        }
    }
    rotation
}

/// Rotation with the largest Σ w bᵀRa.
fn wahba(pairs: &[DirectionPair], weights: &[f64]) -> DQuat {
    let (mut m, mut z) = (DMat3::ZERO, DVec3::ZERO);
    for ((a, b), w) in pairs.iter().zip(weights) {
        m += DMat3::from_cols(*b * a.x, *b * a.y, *b * a.z) * *w;
        z += a.cross(*b) * *w;
    }
    let (trace, s) = (m.x_axis.x + m.y_axis.y + m.z_axis.z, m + m.transpose());
    let mut k = DMat4::from_mat3(s - DMat3::from_diagonal(DVec3::splat(trace)));
    (k.w_axis, k.x_axis.w, k.y_axis.w, k.z_axis.w) = (z.extend(trace), z.x, z.y, z.z);
    // Repeated squaring of the shifted, positive matrix leaves its largest eigenvector.
    let size = |m: &DMat4| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    k += DMat4::IDENTITY * size(&k);
    for _ in 0..SQUARINGS {
        k = k * (1.0 / size(&k));
        k = k * k;
    }
    let columns = [k.x_axis, k.y_axis, k.z_axis, k.w_axis];
    let longest = columns.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    DQuat::from_vec4(longest.unwrap_or_default().normalize_or(glam::DVec4::W))
}

/// Direction with the smallest sum of angles to all (spherical median).
fn middle(directions: &[DVec3]) -> DVec3 {
    let mut middle = directions.iter().sum::<DVec3>().normalize_or(DVec3::Z);
    for _ in 0..ROUNDS {
        let pull: DVec3 = directions.iter().map(|d| *d / angle(*d, middle).max(LEAST)).sum();
        middle = pull.normalize_or(middle);
    }
    middle
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::rng;

    fn direction(random: &mut rng::Rng) -> DVec3 {
        DVec3::from_array([(); 3].map(|()| f64::from(rng::normal(random) as f32))).normalize()
    }

    #[test]
    fn finds_any_rotation_despite_outliers() {
        let mut random = rng::stream(1, "rotation", 0);
        for k in 0..20 {
            let truth = DQuat::from_axis_angle(direction(&mut random), 0.15 * f64::from(k));
            let pair = |i: usize, random: &mut rng::Rng| {
                let a = direction(random);
                // A third of the pairs are random.
                (a, if i.is_multiple_of(3) { direction(random) } else { truth * a })
            };
            let pairs: Vec<DirectionPair> = (0..300).map(|i| pair(i, &mut random)).collect();
            let found = best(&pairs);
            assert!(found.angle_between(truth).to_degrees() < 0.1, "{k}: {found} is not {truth}");
        }
    }

    #[test]
    fn least_squares_rotation_is_exact_without_outliers() {
        let truth = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.2, 2.5);
        let pairs: Vec<DirectionPair> = [DVec3::X, DVec3::Y].map(|a| (a, truth * a)).into();
        assert!(wahba(&pairs, &[1.0, 1.0]).angle_between(truth) < 1e-7);
    }

    #[test]
    fn median_direction_ignores_outliers() {
        let mut directions = vec![DVec3::Z; 7];
        directions.extend([DVec3::X; 3]);
        assert!(angle(middle(&directions), DVec3::Z).to_degrees() < 0.5);
    }
}

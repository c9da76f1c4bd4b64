//! `VirtualTransmitters`: the method that adds up waves from Gaussians to wherever the transmitter stands.

use crate::virtual_transmitters::field::{HARMONICS, field, field_vjp};
use crate::virtual_transmitters::harmonics::{HIGHEST, terms};
use crate::virtual_transmitters::links::Links;
use crate::virtual_transmitters::options::Pursuit;
use pwrfgs_core::{
    Activated, Asked, Cache, Frame, JsonSchema, Layout, Method, MethodTraits, MethodVjp, Observed, Parameters,
    Primitives, Real, Receiver, Task, gains_of, rows_of, sigmoid,
};
use serde::{Deserialize, Serialize};

/// Channels as sums of spherical waves from virtual transmitters: `h(p) = Σ s·exp(−j k d)/d`, eq. (1) of the paper in space,
/// coherent over the whole room.
///
/// By reciprocity the fixed node and the moving one change roles: each Gaussian is the fixed node (the receiver of the
/// data), a mirror image of it, or something that scatters. Its mean is its position, its signal a complex gain, and its
/// quaternion turns the array about it (a mirrored planar array is a turned one). Every subcarrier has its own wavenumber, so
/// delays come for free. Scales and opacities are not looked at, and there is no network: projector, rasterizer,
/// deformation, calibration and readout do not count. The basin of a position is a quarter of a wavelength wide, so start
/// from `MatchingPursuit`; a rate of `means` beyond a hundredth of the wavelength loses it again.
///
/// One receiver with any number of antennas. Exact for flat walls as long as nothing hides an image, and what reflects does
/// so in all directions alike. Real walls, antennas and things in the way do not: with an `order` the gain is a sum of
/// spherical harmonics of the direction from the virtual transmitter, at the price of (order + 1)² complex numbers each,
/// which want data: some ten measured numbers for each unknown.
///
/// ```
/// # use pwrfgs_core::{Method, Plugin};
/// # use pwrfgs_methods as _;
/// let method = Plugin::<dyn Method>::parse("VirtualTransmitters(order: 2)").unwrap();
/// assert_eq!(method.traits().columns, [("harmonics", 16)]);
/// assert!(Plugin::<dyn Method>::parse("VirtualTransmitters(order: 4)").is_err());
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VirtualTransmitters {
    /// Order of the harmonics of a gain over direction, at most 3; 0: the same in all directions.
    pub order: usize,
}

/// The order of harmonics whose gains are among `columns`.
pub(crate) fn order_of(columns: &[(&str, usize)]) -> usize {
    let width = columns.iter().find(|(name, _)| *name == HARMONICS).map_or(0, |(_, width)| *width);
    (0..HIGHEST).find(|order| 2 * (terms(*order) - 1) >= width).unwrap_or(HIGHEST)
}

/// Places of a receiver's antennas about its own, along the axes of the room, metres.
pub(crate) fn array(receiver: &Receiver) -> Vec<[Real; 3]> {
    receiver.array().iter().map(|place| place.map(|x| x as Real)).collect()
}

/// Where the moving end is in each link.
fn positions(asked: &Asked<'_>) -> Vec<[Real; 3]> {
    let txs = asked.conditions.positions();
    asked.links.iter().filter_map(|link| txs.get(link.transmitter)).copied().collect()
}

#[typetag::serde]
impl Method for VirtualTransmitters {
    fn traits(&self) -> MethodTraits<'_> {
        let more = 2 * (terms(self.order.min(HIGHEST)) - 1);
        let columns = if more == 0 { Vec::new() } else { vec![(HARMONICS, more)] };
        MethodTraits { task: Some(Task::Channel), columns, ..MethodTraits::default() }
    }

    /// As the cloud says, whatever the transmitter.
    fn gaussians(&self, _: &Frame, p: &Parameters<'_>, _: Option<[Real; 3]>) -> Activated {
        let own = p.cloud;
        let unit = |q: &[Real; 4]| q.map(|v| v / q.iter().map(|v| v * v).sum::<Real>().sqrt());
        Activated {
            primitives: Primitives {
                means: own.means.clone(),
                scales: own.log_scales.iter().map(|s| s.map(Real::exp)).collect(),
                quats: own.quats.iter().map(unit).collect(),
                opacities: own.opacity_logits.iter().map(|o| sigmoid(*o)).collect(),
            },
            signals: own.signals.as_flattened().to_vec(),
            strengths: Some(own.signals.iter().map(|[a, b]| (a * a + b * b).sqrt()).collect()),
        }
    }

    fn check(&self) -> Result<(), String> {
        Pursuit { order: self.order, ..Pursuit::default() }.check()
    }

    fn forward(&self, frame: &Frame, p: &Parameters<'_>, asked: &Asked<'_>) -> Observed {
        let (positions, antennas) = (positions(asked), array(&frame.receivers[0]));
        let links = Links { positions: &positions, antennas: &antennas, frequencies: &frame.frequencies_hz };
        let numbers = rows_of(&field(p.cloud, p.gate, &links), frame.frequencies_hz.len());
        Observed { numbers, cache: None as Cache }
    }

    fn vjp(&self, frame: &Frame, p: &Parameters<'_>, asked: &Asked<'_>, _: Observed, d: &[Real], sums: &mut MethodVjp) {
        let (positions, antennas) = (positions(asked), array(&frame.receivers[0]));
        let links = Links { positions: &positions, antennas: &antennas, frequencies: &frame.frequencies_hz };
        let found = field_vjp(p.cloud, p.gate, &links, &gains_of(d, frame.frequencies_hz.len()));
        for ((_, _, sum), (_, _, d)) in sums.cloud.columns_mut().zip(found.cloud.columns()) {
            sum.iter_mut().zip(d).for_each(|(sum, d)| *sum += d);
        }
        sums.gate.iter_mut().zip(&found.gate).for_each(|(sum, d)| *sum += d);
        sums.seen.visible.iter_mut().for_each(|seen| *seen += 1.0);
        // How much of the channel is each one's, the mean over directions: pruners that go by what is seen see this.
        let more = p.cloud.extra(HARMONICS);
        for (i, [x, y]) in p.cloud.signals.iter().enumerate() {
            let more = more.map_or(&[][..], |c| &c.values[i * c.width..(i + 1) * c.width]);
            let square = more.iter().fold(x * x + y * y, |sum, c| sum + c * c);
            sums.seen.weight[i] += p.gate.map_or(1.0, |gate| gate[i]) * square.sqrt();
        }
    }

    fn layout(&self, frame: &Frame) -> Result<Layout, String> {
        if !frame.task.is_complex {
            return Err(format!("method: VirtualTransmitters gives channels, and the data are {}", frame.task.plural));
        }
        if frame.receivers.len() != 1 {
            return Err(format!(
                "method: VirtualTransmitters serves one receiver, and the data have {}; train a model for each",
                frame.receivers.len()
            ));
        }
        Ok(Layout::default())
    }
}

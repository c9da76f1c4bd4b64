//! Channels of other programs: arrays with axes in any order and numbers of several types, as channels or as powers.

mod array;
#[cfg(test)]
mod tests;

use super::source::read_positions;
use crate::checks::{check_frequencies, uniform_subcarriers};
use array::Part;
use clap::Args;
use pwrfgs_core::{Channels, Dataset, Error, Observations, Pose, Real, Receiver, Result, Sample, Simulation};
use std::path::PathBuf;

/// Input files and settings of an import of channels.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Channels")]
pub struct ChannelImport {
    /// Channels (CSI): .npy, .npz or .npz:NAME; several files are concatenated along the positions
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "receiver", conflicts_with_all = ["elevation", "scale"])]
    pub channels: Vec<PathBuf>,
    /// Imaginary parts, if they are in separate files
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "channels")]
    pub imag: Vec<PathBuf>,
    /// Order of the axes: positions m, antennas a, subcarriers f, real and imaginary parts ri or ir
    #[arg(long, value_name = "NAMES", default_value = "m,a,f", requires = "channels")]
    pub axes: String,
    /// Transmitter positions: `.npy`, `.npz` or `.csv` with columns x, y, z, metres; `None`: the array `tx` in the first
    /// archive of channels.
    #[arg(skip)]
    pub tx: Option<PathBuf>,
    /// Receiver pose.
    #[arg(skip = Pose::IDENTITY)]
    pub receiver: Pose,
    /// Antenna positions, metres, receiver frame.
    #[arg(
        long,
        value_name = "FILE",
        requires = "channels",
        help = "Antenna positions, metres, receiver frame: .npy or .npz [A, 3],\nor .csv with columns x, y, z [default: one antenna at 0,0,0]"
    )]
    pub antennas: Option<PathBuf>,
    /// Centre frequency of the subcarriers, Hz
    #[arg(long, value_name = "HZ", requires = "channels", allow_hyphen_values = true)]
    pub carrier_hz: Option<f64>,
    /// Subcarrier spacing, Hz
    #[arg(long, value_name = "HZ", requires = "channels", allow_hyphen_values = true)]
    pub spacing_hz: Option<f64>,
    /// Write powers in dB relative to the strongest, with one receiver per subcarrier, or per antenna if there is one subcarrier
    #[arg(long, requires = "channels")]
    pub powers: bool,
    /// Name of the data set.
    #[arg(skip)]
    pub name: String,
    /// Whether the channels are simulated, not measured.
    #[arg(skip)]
    pub simulated: bool,
}

impl ChannelImport {
    /// Reads the channels as a data set, and notes on them, one line each. The ID of a transmitter is its row, counted from
    /// 0. Channels, antennas and subcarriers that are zero were not received: they are left out.
    ///
    /// With `powers`, the data are received powers in dB relative to the strongest. Every subcarrier is a
    /// receiver, with the mean power of all antennas; of one subcarrier, every antenna is a receiver.
    ///
    /// # Errors
    /// Invalid files or settings, axes that do not fit, or numbers without phase that are not to become powers.
    pub fn read(&self) -> Result<(Dataset, Vec<String>)> {
        if let Some((field, fault)) = self.receiver.fault() {
            return Err(Error::Config(format!("{field} of the receiver: {fault}")));
        }
        let first = self.channels.first().ok_or_else(|| Error::Config("--channels names no file".into()))?;
        let tx = read_positions(self.tx.as_deref().unwrap_or(first), self.tx.is_none())?;
        let grid = Grid::read(self, tx)?;
        let received = grid.received();
        if received[0].is_empty() {
            return Err(Error::input(first, "is zero throughout; give channels that were received"));
        }
        let kind = grid.kind().filter(|kind| self.powers || *kind == Kind::Complex);
        let kind = kind.ok_or_else(|| Error::input(first, grid.phase_fault()))?;
        let [m, a, f] = grid.size;
        let mut notes =
            vec![format!("{m} positions, {a} antennas, {f} subcarriers of {} (axes {})", kind.name(), self.axes)];
        for (indices, (total, noun)) in received.iter().zip([(m, "channels"), (a, "antennas"), (f, "subcarriers")]) {
            if let Some(first) = (0..total).find(|i| indices.binary_search(i).is_err()) {
                let count = total - indices.len();
                notes.push(format!(
                    "{count} of {total} {noun} are zero, not received, and left out; the first is {first}"
                ));
            }
        }
        let data = if self.powers {
            self.create_powers(&grid, kind, &received)?
        } else {
            self.create_channels(grid, &received)?
        };
        Ok((Dataset { simulation: self.simulated.then(Simulation::default), ..data }, notes))
    }

    /// Creates the channels of the positions, antennas and subcarriers that were received, as [`Grid::received`] lists them.
    /// Returns an error for a missing or invalid frequency, or another number of antenna positions.
    fn create_channels(&self, mut grid: Grid, [rows, antennas, subcarriers]: &[Vec<usize>; 3]) -> Result<Dataset> {
        let (path, [_, count, width]) = (&self.channels[0], grid.size);
        let missing =
            || Error::Config("--carrier-hz is missing; give the centre frequency in Hz, such as 2.437e9".into());
        let carrier_hz = self.carrier_hz.ok_or_else(missing)?;
        // `uniform_subcarriers` returns the error for a missing spacing.
        check_frequencies(carrier_hz, self.spacing_hz.unwrap_or(1.0)).map_err(Error::Config)?;
        let hz = uniform_subcarriers(path, carrier_hz, self.spacing_hz.unwrap_or(f64::NAN), width)?;
        let positions = self.antennas.as_ref().map_or(Ok(vec![[0.0; 3]]), |path| read_positions(path, false))?;
        if positions.len() != count {
            let problem = format!("has {count} antennas, and --antennas {}", positions.len());
            let advice = "give the position of each in the receiver's frame, or correct --axes";
            return Err(Error::input(path, format!("{problem}; {advice}")));
        }
        // Keeps the gains that were received, in their order.
        let is_in = |list: &[usize], n| (0..n).map(|i| list.binary_search(&i).is_ok()).collect::<Vec<_>>();
        let is_received = [is_in(rows, grid.size[0]), is_in(antennas, count), is_in(subcarriers, width)];
        let mut i = 0;
        grid.gains.retain(|_| {
            i += 1;
            let [row, antenna, subcarrier] = [(i - 1) / (count * width), (i - 1) / width % count, (i - 1) % width];
            is_received[0][row] && is_received[1][antenna] && is_received[2][subcarrier]
        });
        let channels = Channels {
            antennas: antennas.len(),
            frequencies_hz: subcarriers.iter().map(|f| hz[*f]).collect(),
            gains: grid.gains,
        };
        let antennas = antennas.iter().map(|a| positions[*a]).collect();
        let receiver = Receiver { antennas, ..Receiver::new("receiver", self.receiver) };
        let samples: Vec<Sample> = rows.iter().map(|m| Sample::new(*m as u32, grid.tx[*m])).collect();
        Dataset::of_links(&self.name, vec![receiver], vec![], &samples, channels.into())
    }

    /// Creates the received powers, dB relative to the strongest, with a receiver per subcarrier, or per antenna of one
    /// subcarrier; links without power are left out. Returns the errors of [`Dataset::of_links`].
    fn create_powers(&self, grid: &Grid, kind: Kind, received: &[Vec<usize>; 3]) -> Result<Dataset> {
        let [rows, antennas, subcarriers] = received;
        let has_subcarriers = grid.size[2] > 1;
        let (listed, noun) = if has_subcarriers { (subcarriers, "subcarrier") } else { (antennas, "antenna") };
        let (mut samples, mut powers) = (Vec::new(), Vec::new());
        for &m in rows {
            for (receiver, index) in listed.iter().enumerate() {
                let only = std::slice::from_ref(index);
                let (a, f) = if has_subcarriers { (&antennas[..], only) } else { (only, &subcarriers[..]) };
                let power = grid.cells(m, a, f).map(|gain| kind.power(gain)).sum::<f64>() / a.len() as f64;
                if power > 0.0 {
                    samples.push(Sample { receiver, ..Sample::new(m as u32, grid.tx[m]) });
                    powers.push(10.0 * power.log10());
                }
            }
        }
        let strongest = powers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let powers: Observations =
            powers.into_iter().map(|db: f64| (db - strongest) as Real).collect::<Vec<Real>>().into();
        let receiver =
            |k: &usize| Receiver { is_relative: true, ..Receiver::new(format!("{noun} {k}"), self.receiver) };
        let receivers: Vec<Receiver> = listed.iter().map(receiver).collect();
        Dataset::of_links(format!("{} (relative dB)", self.name), receivers, vec![], &samples, powers)
    }
}

/// Channels `[M,A,F]` of all files, row-major.
struct Grid {
    /// Numbers of positions, antennas and subcarriers.
    size: [usize; 3],
    /// Real and imaginary parts.
    gains: Vec<[Real; 2]>,
    /// Transmitter positions `[M,3]`, metres.
    tx: Vec<[f64; 3]>,
}

impl Grid {
    /// Reads the files of `import` and concatenates them along the positions. Returns an error for an invalid file, other
    /// antennas or subcarriers than in the first file, or another number of positions than transmitters `tx`.
    fn read(import: &ChannelImport, tx: Vec<[f64; 3]>) -> Result<Self> {
        let (files, imag) = (&import.channels, &import.imag);
        if !imag.is_empty() && imag.len() != files.len() {
            let problem = format!("--imag names {} files, and --channels {}", imag.len(), files.len());
            return Err(Error::Config(format!("{problem}; give a file of imaginary parts per file of real parts")));
        }
        let (mut size, mut gains) = ([0; 3], Vec::new());
        for (k, path) in files.iter().enumerate() {
            let part = if imag.is_empty() { Part::Whole } else { Part::Real };
            let shape @ [m, a, f] = part.read(path, &import.axes, &mut gains)?;
            if let Some(imag) = imag.get(k) {
                Part::Imaginary(shape).read(imag, &import.axes, &mut gains)?;
            }
            if k > 0 && [a, f] != size[1..] {
                let problem =
                    format!("has {a} antennas and {f} subcarriers, but the first file {} and {}", size[1], size[2]);
                return Err(Error::input(path, format!("{problem}; give files of one receiver")));
            }
            size = [size[0] + m, a, f];
        }
        if size[0] != tx.len() {
            let problem = format!("holds channels of {} positions, and --tx has {}", size[0], tx.len());
            let advice = format!("give as many of each, or correct --axes, which is {}", import.axes);
            return Err(Error::input(&files[0], format!("{problem}; {advice}")));
        }
        Ok(Self { size, gains, tx })
    }

    /// Returns the gains of these antennas and subcarriers at position `m`.
    fn cells(&self, m: usize, antennas: &[usize], subcarriers: &[usize]) -> impl Iterator<Item = [f64; 2]> {
        let [_, count, width] = self.size;
        antennas.iter().flat_map(move |a| {
            subcarriers.iter().map(move |f| self.gains[(m * count + a) * width + f].map(|v| v as f64))
        })
    }

    /// Returns the indices of the positions, of the antennas and of the subcarriers that have a gain other than zero.
    fn received(&self) -> [Vec<usize>; 3] {
        let [_, a, f] = self.size;
        let mut is_received = self.size.map(|n| vec![false; n]);
        for (i, _) in self.gains.iter().enumerate().filter(|(_, gain)| **gain != [0.0; 2]) {
            [i / (a * f), i / f % a, i % f].into_iter().zip(&mut is_received).for_each(|(k, list)| list[k] = true);
        }
        is_received.map(|list| (0..list.len()).filter(|i| list[*i]).collect())
    }

    /// Returns the meaning of the numbers; `None` for real numbers of both signs, whose imaginary parts are probably elsewhere.
    fn kind(&self) -> Option<Kind> {
        let any = |is: fn(&[Real; 2]) -> bool| self.gains.iter().any(is);
        match (any(|[_, im]| *im != 0.0), any(|[re, _]| *re < 0.0), any(|[re, _]| *re > 0.0)) {
            (true, ..) => Some(Kind::Complex),
            (false, false, _) => Some(Kind::Amplitude),
            (false, true, false) => Some(Kind::Decibel),
            (false, true, true) => None,
        }
    }

    /// Returns the problem with numbers that have no phase, with the next step.
    fn phase_fault(&self) -> String {
        match self.kind() {
            Some(kind) => format!("these are {}, which have no phase; add --powers", kind.name()),
            None => "these are real numbers of both signs, without imaginary parts; name the files of these with --imag, or \
                     their axis with ri in --axes"
                .into(),
        }
    }
}

/// Meaning of the numbers of an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Real and imaginary parts.
    Complex,
    /// Moduli of channels.
    Amplitude,
    /// Negative levels, dB.
    Decibel,
}

impl Kind {
    /// Returns the name of the numbers, plural.
    fn name(self) -> &'static str {
        match self {
            Self::Complex => "complex numbers",
            Self::Amplitude => "amplitudes",
            Self::Decibel => "levels in dB",
        }
    }

    /// Returns the power of a number, linear; 0 if it was not received.
    fn power(self, [re, im]: [f64; 2]) -> f64 {
        match self {
            Self::Decibel if re < 0.0 => 10f64.powf(re / 10.0),
            _ => re * re + im * im,
        }
    }
}

//! Positions and bounds as text, the axis-parallel plane of a map, and the grid of positions on it.

use pwrfgs_core::{Error, Geodetic, MAX_COORDINATE_M, Pose, Result, coordinate_fault, position_fault};

/// Names of the coordinates.
const AXES: [&str; 3] = ["x", "y", "z"];
/// Maximum number of positions of a map.
const MOST: f64 = 4e6;
/// Maximum number of pairs of position and receiver of a map.
const MOST_VALUES: f64 = 16.0 * MOST;
/// Largest number of positions of a map whose default grid spacing is above [`PlaneBounds::STEP`].
const USUAL: f64 = 2.5e5;

/// Parses `N` numbers separated by commas; `None` for other text.
pub fn parse_numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|t| t.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

/// Parses `x,y,z` in metres, the value of `option`.
///
/// # Errors
/// Other text, or a coordinate that is not finite or beyond 1e8 m.
pub fn parse_position(option: &str, text: &str) -> Result<[f64; 3]> {
    let wrong =
        || Error::Config(format!("{option} {text}: expected x,y,z in metres, each at most 1e8, such as 3.5,2.2,1.2"));
    parse_numbers(text).filter(|position| position_fault(*position).is_none()).ok_or_else(wrong)
}

/// Parses `x,y,z,qx,qy,qz,qw`, metres and a unit quaternion from receiver axes to world axes, the value of `option`.
///
/// # Errors
/// Text that is not seven numbers, or an invalid pose.
pub fn parse_pose(option: &str, text: &str) -> Result<Pose> {
    let refuse = |fault: &str| Err(Error::Config(format!("{option} {text}: {fault}")));
    let Some([x, y, z, orientation @ ..]) = parse_numbers::<7>(text) else {
        return refuse("expected x,y,z,qx,qy,qz,qw, such as 3.5,2.2,1.2,0,0,0,1 for no rotation");
    };
    let pose = Pose { position: [x, y, z], orientation };
    pose.fault().map_or(Ok(pose), |(_, fault)| refuse(&fault))
}

/// Plane with one fixed coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPlane {
    /// Index of the fixed coordinate: 0 for x.
    pub axis: usize,
    /// Value of the fixed coordinate, metres.
    pub coordinate: f64,
}

impl MapPlane {
    /// Parses `z=1.2`, metres, the value of `--plane`.
    ///
    /// # Errors
    /// Other text, or a coordinate that is not finite or beyond 1e8 m.
    pub fn parse(text: &str) -> Result<Self> {
        let wrong = || {
            Error::Config(format!(
                "--plane {text}: expected a fixed coordinate in metres, such as z=1.2, x=0.5 or y=-3"
            ))
        };
        let (name, coordinate) = text.split_once('=').ok_or_else(wrong)?;
        let axis = AXES.iter().position(|axis| name.trim().eq_ignore_ascii_case(axis)).ok_or_else(wrong)?;
        let is_valid = |coordinate: &f64| coordinate_fault(*coordinate).is_none();
        let coordinate = coordinate.trim().parse().ok().filter(is_valid).ok_or_else(wrong)?;
        Ok(Self { axis, coordinate })
    }

    /// Returns the indices of the two free coordinates, horizontal first.
    pub fn free_axes(&self) -> [usize; 2] {
        [[1, 2], [0, 2], [0, 1]][self.axis]
    }

    /// Returns the names of the free coordinates.
    pub fn axis_names(&self) -> [&'static str; 2] {
        self.free_axes().map(|k| AXES[k])
    }

    /// Describes the plane, such as `z = 1.2 m`.
    pub fn describe(&self) -> String {
        format!("{} = {} m", AXES[self.axis], self.coordinate)
    }

    /// Returns the position in space of the point `[a, b]` on the plane, its free coordinates in metres.
    fn position(&self, [a, b]: [f64; 2]) -> [f64; 3] {
        let mut position = [self.coordinate; 3];
        let [across, up] = self.free_axes();
        (position[across], position[up]) = (a, b);
        position
    }

    /// Projects a position or vector onto the plane: its two free coordinates.
    pub fn project(&self, position: [f64; 3]) -> [f64; 2] {
        self.free_axes().map(|k| position[k])
    }
}

/// Extent of a map: low and high of the first and second free coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneBounds(
    /// Low and high end per free coordinate, metres.
    pub [[f64; 2]; 2],
);

impl PlaneBounds {
    /// Parses `x0,x1,y0,y1`, metres, the value of `option`; `names` are those of the coordinates, for the error.
    ///
    /// # Errors
    /// Other text, a coordinate that is not finite or beyond 1e8 m, or a low end above its high end.
    pub fn parse(option: &str, text: &str, names: [&str; 2]) -> Result<Self> {
        let [a, b] = names;
        let wrong = || {
            Error::Config(format!(
                "{option} {text}: expected metres as {a}0,{a}1,{b}0,{b}1, the smaller first, such as 0,8,0,6"
            ))
        };
        let fits = |ends: &[f64; 4]| {
            ends.iter().all(|v| coordinate_fault(*v).is_none()) && ends[0] <= ends[1] && ends[2] <= ends[3]
        };
        let [x0, x1, y0, y1] = parse_numbers(text).filter(fits).ok_or_else(wrong)?;
        Ok(Self([[x0, x1], [y0, y1]]))
    }

    /// Returns whether a point is inside or on the edge.
    pub fn has_point(&self, point: [f64; 2]) -> bool {
        self.0.iter().zip(point).all(|([low, high], v)| (*low..=*high).contains(&v))
    }

    /// Smallest default grid spacing, metres.
    pub const STEP: f64 = 0.1;

    /// Returns the default grid spacing of a map at so many `receivers`: [`Self::STEP`], or for a map that is then too large the
    /// first of 1, 2, 5, 10 .. m with at most 250,000 positions and 64 million pairs of position and receiver.
    pub fn default_step(self, receivers: usize) -> f64 {
        let count = |step: f64| self.0.iter().map(|[low, high]| (high - low) / step + 2.0).product::<f64>();
        let limit = MOST_VALUES / receivers.max(1) as f64;
        let most = USUAL.min(limit);
        let is_small = count(Self::STEP) <= MOST.min(limit);
        let steps = (0..10).flat_map(|power| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(power)));
        let mut steps =
            std::iter::once(Self::STEP).filter(|_| is_small).chain(steps.filter(|step| count(*step) <= most));
        steps.next().unwrap_or(MAX_COORDINATE_M)
    }

    /// Returns the bounds in metres. In a frame with latitude and longitude, bounds within a degree of its zero are in degrees:
    /// latitudes, then longitudes, or the reverse. Other bounds are in metres already.
    #[must_use]
    pub fn in_metres(self, geodetic: Option<Geodetic>) -> Self {
        let Some(zero) = geodetic else { return self };
        let is_near = |ends: [f64; 2], zero: f64| ends.iter().all(|v| (v - zero).abs() < 1.0);
        let is_angle = |[a, b]: &[[f64; 2]; 2]| is_near(*a, zero.latitude) && is_near(*b, zero.longitude);
        let Some([latitudes, longitudes]) = [self.0, [self.0[1], self.0[0]]].into_iter().find(is_angle) else {
            return self;
        };
        let [low, high] = [0, 1].map(|k| zero.metres([latitudes[k], longitudes[k]]));
        Self([0, 1].map(|k| [low[k], high[k]]))
    }

    /// Returns the bounds extended to multiples of `step`, or unchanged if the multiples are not finite.
    pub fn rounded_outwards(self, step: f64) -> Self {
        let rounded = |[low, high]: [f64; 2]| [(low / step).floor() * step, (high / step).ceil() * step];
        let out = self.0.map(rounded);
        if out.iter().flatten().all(|v| v.is_finite()) { Self(out) } else { self }
    }

    /// Creates bounds around the central 90 % of `cloud` and all `points`, metres; two metres wide along a coordinate in
    /// which all are equal, or if there are none.
    pub fn around(mut cloud: Vec<[f64; 2]>, points: &[[f64; 2]]) -> Self {
        cloud.retain(|point| point.iter().all(|v| v.is_finite()));
        let ends_along = |k: usize| {
            let mut values: Vec<f64> = cloud.iter().map(|point| point[k]).collect();
            values.sort_by(f64::total_cmp);
            let last = values.len().saturating_sub(1) as f64;
            let ends = [0.05, 0.95].map(|q| values.get((q * last).round() as usize).copied());
            let coordinates = || ends.iter().flatten().copied().chain(points.iter().map(|point| point[k]));
            [coordinates().fold(f64::INFINITY, f64::min), coordinates().fold(f64::NEG_INFINITY, f64::max)]
        };
        Self([ends_along(0), ends_along(1)].map(|[low, high]| match high - low {
            gap if gap > 0.0 => [low, high],
            _ if low.is_finite() => [low - 1.0, low + 1.0],
            _ => [-1.0, 1.0],
        }))
    }
}

/// Grid of positions on a plane, row by row, lowest row first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneGrid {
    /// Plane of all positions.
    pub plane: MapPlane,
    /// First and second free coordinate of the first position, metres.
    pub first: [f64; 2],
    /// Distance of neighbours, metres.
    pub step: f64,
    /// Number of positions along the first free coordinate.
    pub columns: usize,
    /// Number of positions along the second free coordinate.
    pub rows: usize,
}

impl PlaneGrid {
    /// Creates the grid of a map at so many `receivers`, from the low ends of the bounds.
    ///
    /// # Errors
    /// `step` is out of range, or the grid is too large.
    pub fn new(plane: MapPlane, bounds: PlaneBounds, step: f64, receivers: usize) -> Result<Self> {
        let PlaneBounds([across, up]) = bounds;
        if !(1e-6..=MAX_COORDINATE_M).contains(&step) {
            return Err(Error::Config(format!(
                "--step {step}: expected a grid spacing in metres, 1e-6 to {MAX_COORDINATE_M:e}, such as 0.1"
            )));
        }
        let count = |[low, high]: [f64; 2]| ((high - low) / step + 1e-6).floor() + 1.0;
        let (columns, rows) = (count(across), count(up));
        if columns * rows > MOST || columns * rows * receivers as f64 > MOST_VALUES {
            return Err(Error::Config(format!(
                "map of {columns} x {rows} positions and {receivers} receivers is too large; increase --step, reduce --bounds or \
                 set --receiver"
            )));
        }
        Ok(Self { plane, first: [across[0], up[0]], step, columns: columns as usize, rows: rows as usize })
    }

    /// Returns the number of positions.
    pub fn position_count(&self) -> usize {
        self.columns * self.rows
    }

    /// Returns position `k` of the grid in space, metres, world frame.
    pub fn position(&self, k: usize) -> [f64; 3] {
        let coordinate = |n: usize, axis: usize| self.first[axis] + self.step * n as f64;
        self.plane.position([coordinate(k % self.columns, 0), coordinate(k / self.columns, 1)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_three_finite_numbers() {
        assert_eq!(parse_position("--tx", "1, -2.5,3e0").unwrap(), [1.0, -2.5, 3.0]);
        for wrong in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,NaN", "1,inf,2", "1,2,1e9"] {
            assert!(parse_position("--tx", wrong).unwrap_err().is_input(), "{wrong}");
        }
    }

    #[test]
    fn parses_planes_and_bounds_and_rejects_invalid_ones() {
        assert_eq!(MapPlane::parse("Z= -1.5").unwrap(), MapPlane { axis: 2, coordinate: -1.5 });
        for wrong in ["", "z", "w=1", "z=", "z=NaN", "z=1e9", "z=1,2"] {
            assert!(MapPlane::parse(wrong).unwrap_err().is_input(), "{wrong}");
        }
        assert_eq!(PlaneBounds::parse("--bounds", "0, 8,-1,6", ["x", "y"]).unwrap().0, [[0.0, 8.0], [-1.0, 6.0]]);
        for wrong in ["", "0,1,2", "1,0,0,1", "0,1,0,inf", "0,1,0,1,2"] {
            assert!(PlaneBounds::parse("--bounds", wrong, ["x", "y"]).is_err(), "{wrong}");
        }
    }

    #[test]
    fn default_step_keeps_grids_below_the_limit() {
        let step = |side: f64, layers| PlaneBounds([[0.0, side], [0.0, side]]).default_step(layers);
        assert_eq!([step(8.0, 1), step(190.0, 1), step(600.0, 1), step(5e3, 1)], [0.1, 0.1, 2.0, 20.0]);
        assert_eq!([step(600.0, 520), step(5e3, 520), step(1e8, 1)], [2.0, 20.0, 500_000.0]);
        for side in [600.0, 5e3, 1e8] {
            let bounds = PlaneBounds([[0.0, side], [-side, 0.0]]);
            let step = bounds.default_step(520);
            let plane = MapPlane { axis: 2, coordinate: 1.0 };
            assert!(PlaneGrid::new(plane, bounds.rounded_outwards(step), step, 520).is_ok(), "{side}");
        }
    }

    #[test]
    fn bounds_near_the_zero_of_degrees_are_degrees() {
        let zero = Some(Geodetic { latitude: 48.14, longitude: 11.58 });
        let box_of = |ends: [[f64; 2]; 2]| PlaneBounds(ends).in_metres(zero).0;
        let expected = box_of([[48.13, 48.15], [11.57, 11.59]]);
        assert!((expected[1][1] - 1112.0).abs() < 2.0 && (expected[0][0] + 744.0).abs() < 2.0, "{expected:?}");
        assert_eq!(box_of([[11.57, 11.59], [48.13, 48.15]]), expected, "longitudes first");
        let metres = [[-300.0, 300.0], [0.0, 11.6]];
        assert_eq!(box_of(metres), metres);
        let degrees = PlaneBounds([[48.13, 48.15], [11.57, 11.59]]);
        assert_eq!(degrees.in_metres(None), degrees);
    }

    #[test]
    fn map_grid_runs_from_low_to_high() {
        let plane = MapPlane { axis: 1, coordinate: 9.0 };
        let grid = PlaneGrid::new(plane, PlaneBounds([[0.0, 0.3], [1.0, 1.2]]), 0.1, 1).unwrap();
        assert_eq!((grid.columns, grid.rows), (4, 3));
        let last = grid.position(11);
        assert!((last[0] - 0.3).abs() < 1e-12 && last[1] == 9.0 && (last[2] - 1.2).abs() < 1e-12, "{last:?}");
        for step in [0.0, -1.0, f64::NAN, 1e-5, 1e300] {
            assert!(PlaneGrid::new(plane, PlaneBounds([[0.0, 100.0]; 2]), step, 1).is_err(), "{step}");
        }
        assert_eq!(PlaneBounds::around(vec![], &[[1.0, 2.0]]).0, [[0.0, 2.0], [1.0, 3.0]]);
        assert_eq!(PlaneBounds([[-0.3, 1.0], [0.0, 0.1]]).rounded_outwards(0.5).0, [[-0.5, 1.0], [0.0, 0.5]]);
        assert_eq!(PlaneBounds::around(vec![[f64::NAN; 2]], &[]).0, [[-1.0, 1.0]; 2]);
    }
}

//! `Geodetic`: latitude and longitude of a local east-north frame.

use crate::JsonSchema;
use serde::{Deserialize, Serialize};

/// Semi-major axis of the WGS 84 ellipsoid, metres.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
/// Squared eccentricity of the WGS 84 ellipsoid.
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_141_32e-3;

/// Point on the Earth at the zero of a local frame: x is east, y is north.
///
/// Metres and degrees are proportional to each other, with the radii of curvature of WGS 84 at this point. Within 5 km of
/// it, distances deviate by less than one part in a thousand at latitudes up to 50 degrees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Geodetic {
    /// Latitude of the zero, degrees north.
    pub latitude: f64,
    /// Longitude of the zero, degrees east.
    pub longitude: f64,
}

impl Geodetic {
    /// Names of the columns of [`Self::cells`] in the header of a table.
    pub const COLUMNS: &str = ",latitude,longitude";

    /// Returns metres per degree of longitude (east) and of latitude (north).
    fn metres_per_degree(self) -> [f64; 2] {
        let (sin, cos) = self.latitude.to_radians().sin_cos();
        let w = 1.0 - ECCENTRICITY_SQUARED * sin * sin;
        let (prime_vertical, meridian) =
            (SEMI_MAJOR_M / w.sqrt(), SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / w.powf(1.5));
        // An arc of one degree has the length of its radius times π/180.
        [(prime_vertical * cos).to_radians(), meridian.to_radians()]
    }

    /// Converts degrees to metres east and north of the zero.
    pub fn metres(self, [latitude, longitude]: [f64; 2]) -> [f64; 2] {
        let [east, north] = self.metres_per_degree();
        [(longitude - self.longitude) * east, (latitude - self.latitude) * north]
    }

    /// Converts metres east and north of the zero to latitude and longitude, degrees.
    pub fn degrees(self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [east, north] = self.metres_per_degree();
        [self.latitude + y / north, self.longitude + x / east]
    }

    /// Returns the last two cells of a table row, each after a comma: latitude and longitude, degrees, of a position in the
    /// user's frame, metres.
    pub fn cells(self, [x, y, _]: [f64; 3]) -> String {
        let [latitude, longitude] = self.degrees([x, y]);
        format!(",{latitude:.7},{longitude:.7}")
    }

    /// Returns whether both angles are on the Earth, with a latitude below 89 degrees: meridians converge at the poles.
    pub fn is_valid(self) -> bool {
        self.latitude.abs() < 89.0 && self.longitude.abs() <= 180.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lengths of a degree at 45 degrees: published tables of WGS 84.
    #[test]
    fn degree_has_published_length() {
        let zero = Geodetic { latitude: 45.0, longitude: 7.0 };
        let [east, north] = zero.metres([46.0, 8.0]);
        assert!((east - 78_846.8).abs() < 0.1 && (north - 111_131.8).abs() < 0.1, "{east} {north}");
        let [latitude, longitude] = zero.degrees([east, north]);
        assert!((latitude - 46.0).abs() < 1e-12 && (longitude - 8.0).abs() < 1e-12);
    }
}

//! `PowerUnit`: unit of the received powers in a table.

use std::str::FromStr;

/// Unit of received powers in a table.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PowerUnit {
    /// dBm.
    #[default]
    Dbm,
    /// dBm without the minus sign.
    PositiveDbm,
    /// Quality in per cent as Windows shows it: 0 is -100 dBm, 100 is -50 dBm.
    PerCent,
    /// dB over a floor, dBm.
    DbOver(f64),
    /// Milliwatts; 0 is no signal.
    Milliwatt,
    /// Watts; 0 is no signal.
    Watt,
}

impl PowerUnit {
    /// Converts a value to dBm; `None` for no signal.
    pub fn dbm(self, value: f64) -> Option<f64> {
        let dbm = match self {
            Self::Dbm => value,
            Self::PositiveDbm => -value,
            Self::PerCent => 0.5 * value - 100.0,
            Self::DbOver(floor) => value + floor,
            Self::Milliwatt => 10.0 * value.log10(),
            Self::Watt => 10.0 * value.log10() + 30.0,
        };
        (dbm != f64::NEG_INFINITY).then_some(dbm)
    }
}

impl FromStr for PowerUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let floor = || text.strip_prefix("dB:")?.parse().ok().filter(|floor: &f64| floor.is_finite());
        match text {
            "dBm" => Ok(Self::Dbm),
            "positive-dBm" => Ok(Self::PositiveDbm),
            "percent" => Ok(Self::PerCent),
            "mW" => Ok(Self::Milliwatt),
            "W" => Ok(Self::Watt),
            _ => floor().map(Self::DbOver).ok_or_else(|| {
                format!(
                    "{text}: expected dBm, positive-dBm (sign lost), percent (-100 + percent / 2 dBm), dB:FLOOR (over a \
                     floor in dBm, such as dB:-95), mW or W"
                )
            }),
        }
    }
}

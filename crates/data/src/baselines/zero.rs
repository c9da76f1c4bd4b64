//! `Zero`: no channel at all.

use super::{Constant, all_of};
use pwrfgs_core::{Baseline, Dataset, Error, Image, JsonSchema, Known, Predict, Result, Task};
use serde::{Deserialize, Serialize};

/// A channel of zeros: an SNR of 0 dB, which a prediction with wrong phases does not reach.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("Zero()").unwrap().name(), "zero");
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Zero {}

#[typetag::serde]
impl Baseline for Zero {
    fn name(&self) -> String {
        "zero".into()
    }

    fn check_data(&self, data: &Dataset) -> Result<()> {
        if self.supports(data.task()) {
            return Ok(());
        }
        let what = format!("Zero() is a floor of channels, and {} holds {}", data.title, data.task().plural);
        Err(Error::Config(format!("{what}; use MeanSpectrum()")))
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        all_of(known)?;
        Ok(Box::new(Constant(Image::zeros(data.width, data.height))))
    }

    fn supports(&self, task: Task) -> bool {
        task.is_complex
    }
}

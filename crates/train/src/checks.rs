//! What a plan and its data must have in common before a training begins.

use crate::settings::Rays;
use pwrfgs_core::{Dataset, Error, Result};
use pwrfgs_model::Stages;

/// Refuses rays where there are no pixels to choose, and more than a step can be meant to have.
pub(crate) fn check_rays(rays: Rays, stages: &Stages) -> Result<()> {
    let most = match rays {
        Rays::All => return Ok(()),
        Rays::Same(_) => stages.frame.numbers(),
        Rays::Each(_) => MOST_PAIRS,
    };
    if !stages.frame.task.has_pixels {
        let what = stages.frame.task.plural;
        return Err(Error::Config(format!(
            "training.rays chooses pixels of spectra, and the data are {what}; leave it out"
        )));
    }
    match rays {
        Rays::Same(count) | Rays::Each(count) if count > most => {
            Err(Error::Config(format!("training.rays has {count}; give at most {most}")))
        }
        _ => Ok(()),
    }
}

/// Pairs of a spectrum and a pixel a step.
const MOST_PAIRS: usize = 1 << 22;

/// Refuses data that describe a transmitter by other numbers than the method wants.
pub(crate) fn check_inputs(stages: &Stages, data: &Dataset) -> Result<()> {
    let own = stages.deformation().is_none();
    let (wants, has) = (stages.method.traits().inputs, data.features.as_ref().map_or(3, |features| features.width));
    if data.features.is_none() && !data.placed {
        return Err(Error::Config("the data have neither positions nor features of the transmitters".into()));
    }
    if has == 3 && data.features.is_some() {
        return Err(Error::Config(
            "3 features look like a position, and are taken for one; give more, or positions".into(),
        ));
    }
    if wants == has {
        return Ok(());
    }
    let what = |n: usize, features: bool| if features { format!("{n} features") } else { "a position".to_owned() };
    Err(Error::Config(format!(
        "the method wants {} of a transmitter, and the data give {}; {}",
        what(wants, wants != 3),
        what(has, data.features.is_some()),
        match (own, data.features.is_some()) {
            (true, true) => format!("give the method that many, such as Nerf2(features: {has})"),
            (true, false) => "leave `features` of the method out".into(),
            (false, true) => format!("give deformation: Factored(tx_encoding: Features(width: {has}))"),
            (false, false) => "leave `Features` out".into(),
        }
    )))
}

//! One file a verb.

mod evaluate;
mod plugins;
mod predict;
mod run;

pub(crate) use evaluate::evaluate;
pub(crate) use plugins::plugins;
pub(crate) use predict::predict;
pub(crate) use run::run;

//! One file a verb.

mod evaluate;
mod export;
mod plugins;
mod predict;
mod report;
mod run;
mod simulate;
mod sweep;

pub(crate) use evaluate::evaluate;
pub(crate) use export::export;
pub(crate) use plugins::plugins;
pub(crate) use predict::predict;
pub(crate) use report::report;
pub(crate) use run::run;
pub(crate) use simulate::simulate;
pub(crate) use sweep::sweep;

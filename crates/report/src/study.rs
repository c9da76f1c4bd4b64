//! Tables and figures that compare the runs of a [`Study`](pwrfgs_experiment::Study), and their folder.

mod comparison;
mod csv;
pub mod figures;
mod output;
mod page;
mod reference;
mod tables;

pub use output::write;
pub use page::ReportOptions;

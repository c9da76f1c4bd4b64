//! `pwrfgs plan`: positions to measure next.

mod source;

use crate::interrupt::stop_flag;
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::{Session, text::grouped};
use pwrfgs::tasks::plan::{PlanSettings, plan as select_positions};
use pwrfgs_core::Result;
use pwrfgs_core::files::NewFolder;
use source::{PositionOptions, read_positions};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
The command selects one candidate position after another: the candidate that most reduces the
variance of a Gaussian process, summed over the region. For comparison, it prints three selections
of the same number of positions: random ones, every k-th candidate (regular), and always the
candidate of largest variance. It writes plan.csv (order, candidate, position, mean variance over
the region once this position is measured) and plan.png.
CANDIDATES
  SOURCE alone           the positions of a data folder, all of them treated as not measured
  --candidates, --floor  new positions; positions of SOURCE (data, run or model) are measured
LENGTH SCALE (distance over which the correlation of the Gaussian process falls to 37 %)
  new candidates for a data folder  estimated from its measurements, by maximum likelihood
  --simulate                        estimated after 8, 16, 32, .. selected positions
  otherwise                         a fifth of the diagonal of the region

EXAMPLES
  pwrfgs plan data/s23 --simulate --count 100 --out next
  pwrfgs plan data/mine --candidates new.csv --count 20 --out next
  pwrfgs plan --floor scenes/office.ron --step 0.25 --height 1.2 --count 20 --out next")]
pub(crate) struct Plan {
    #[command(flatten)]
    pub(crate) positions: PositionOptions,
    #[command(flatten)]
    pub(crate) settings: PlanSettings,
    /// Output folder; must be new or empty
    #[arg(short, long, value_name = "DIR", default_value = "plan")]
    pub(crate) out: PathBuf,
}

/// Runs `pwrfgs plan`: prints the plan and other choices, and writes its list and map.
pub(crate) fn plan(arguments: &Plan, verbosity: Verbosity) -> Result<()> {
    let stop = stop_flag();
    let positions = RunProgress::observe(verbosity, |progress| read_positions(&arguments.positions, progress))?;
    let folder = NewFolder::begin(&arguments.out)?;
    let plan = RunProgress::observe(verbosity, |progress| {
        select_positions(&positions, &arguments.settings, &mut Session { stop: &stop, ..Session::new(progress) })
    })?;
    plan.write(&positions, &folder)?;
    folder.publish()?;
    output::print_result(&plan.text)?;
    verbosity.print_note(&format!("{} positions in {}", grouped(plan.order.len() as i64), arguments.out.display()));
    Ok(())
}

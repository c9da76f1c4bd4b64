//! An ensemble: several runs whose models predict together, trained by one command and saved as one model.
//!
//! `file.rs` reads what a user writes, `run.rs` trains the members and makes one model of theirs. Each member is a run in a
//! folder of its own below `members`, which is a sweep folder: it can be reported on, and goes on after any end.

mod file;
mod run;

pub use file::{EnsembleFile, Member, MemberFile};
pub use run::{MEMBERS, run_team};

use crate::sweep::{Plan, PlannedRun};
use file::{Written, WrittenMember};
use pwrfgs_core::plugin::{to_ron, try_to_ron};
use pwrfgs_core::{Error, Result};
use pwrfgs_pipeline::Pipeline;
use std::path::Path;

/// The members of an ensemble as they are trained; paths are absolute.
#[derive(Clone, Debug)]
pub struct Team {
    name: String,
    members: Vec<Pipeline>,
}

/// The most members of one ensemble.
const MOST: usize = 100;

/// Everything of a pipeline that decides the model.
fn trained(pipeline: &Pipeline) -> String {
    let unnamed = Pipeline { name: String::new(), baselines: Vec::new(), metrics: Vec::new(), ..pipeline.essential() };
    to_ron(&unnamed)
}

impl Team {
    /// Of two members or more on the same data, divided in the same way.
    ///
    /// # Errors
    /// What does not fit together.
    fn new(name: String, mut members: Vec<Pipeline>) -> Result<Self, String> {
        if !(2..=MOST).contains(&members.len()) {
            return Err(format!("it has {} members; give 2 to {MOST}, counting every seed", members.len()));
        }
        let split_seed = members.iter().find_map(|member| member.split_seed).unwrap_or(members[0].seed);
        if members.iter().any(|member| member.split_seed.is_some_and(|own| own != split_seed)) {
            return Err("its members have different values of `split_seed`; give all the same, or none".into());
        }
        members.iter_mut().for_each(|member| member.split_seed = Some(split_seed));
        let first = &members[0];
        let trained: Vec<String> = members.iter().map(trained).collect();
        for (place, member) in members.iter().enumerate() {
            let own = &member.name;
            if members[..place].iter().any(|other| other.name.eq_ignore_ascii_case(own)) {
                return Err(format!("two members are called `{own}`; give one another `label`"));
            }
            if let Some(twin) = trained[..place].iter().position(|other| *other == trained[place]) {
                return Err(format!(
                    "the members `{}` and `{own}` are trained alike and give the same model; change the `seed` or a \
                     setting of one",
                    members[twin].name
                ));
            }
            let differs = |what: &str, advice: &str| {
                Err(format!("the members `{}` and `{own}` have another `{what}`; {advice}", first.name))
            };
            if to_ron(&first.data) != to_ron(&member.data) {
                return differs("data", "say `set: (data: ..)` for all of them");
            }
            if to_ron(&first.split) != to_ron(&member.split) {
                return differs(
                    "split",
                    "one would have learnt what the other is tested on: say `set: (split: ..)` for all",
                );
            }
            if first.projector.plane(360, 90) != member.projector.plane(360, 90) {
                return differs("projector", "their pictures have other pixels, and no mean");
            }
        }
        Ok(Self { name, members })
    }

    /// Data, split, baselines and metrics: the first member's, under the name of the ensemble.
    pub fn pipeline(&self) -> Pipeline {
        Pipeline { name: self.name.clone(), ..self.members[0].clone() }
    }

    /// All members.
    pub fn members(&self) -> &[Pipeline] {
        &self.members
    }

    /// The ensemble as RON text, every member whole.
    pub(crate) fn text(&self) -> Result<String, String> {
        let members = self.members.iter().map(WrittenMember::Pipeline).collect();
        try_to_ron(&Written { name: &self.name, members })
    }

    /// The same without what changes nothing of the result.
    pub(crate) fn essential(&self) -> Self {
        Self { name: self.name.clone(), members: self.members.iter().map(Pipeline::essential).collect() }
    }

    /// The same, each member changed by that of `other` in its place.
    pub(crate) fn zipped(&self, other: &Self, change: impl Fn(&Pipeline, &Pipeline) -> Pipeline) -> Self {
        let mut own = self.clone();
        own.members.iter_mut().zip(&other.members).for_each(|(own, other)| *own = change(own, other));
        own
    }

    /// The members as runs of a sweep in `folder`. Baselines are scored once, beside the ensemble.
    pub fn plan(&self, folder: &Path) -> Plan {
        let run = |(combination, member): (usize, &Pipeline)| {
            let pipeline = Pipeline { baselines: Vec::new(), ..member.clone() };
            let labels = vec![("member".to_owned(), member.name.clone())];
            PlannedRun::new(member.name.clone(), labels, combination, pipeline)
        };
        Plan::of(self.name.clone(), folder, self.members.iter().enumerate().map(run).collect())
    }

    /// Refuses an ensemble that cannot be written.
    pub(crate) fn check_text(&self) -> Result<()> {
        self.members.iter().try_for_each(Pipeline::check_text)?;
        self.text().map(|_| ()).map_err(Error::Config)
    }
}

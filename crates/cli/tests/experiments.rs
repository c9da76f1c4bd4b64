//! `experiments/README.md`, made from the headers of the experiments. To write it anew:
//! `PWRFGS_PAGES=write cargo test -p pwrfgs-cli --test cli experiments::`.

use crate::common::{stdout, succeed};
use crate::prose::root;
use regex::Regex;
use std::fmt::Write as _;
use std::path::PathBuf;

const BEFORE: &str = "# Experiments

This page lists the sweeps of this folder, for readers who repeat or extend a result.
`pwrfgs sweep NAME` runs a sweep, `--dry-run` prints its runs, and the [guide](../docs/guide.md) explains the files.

| experiment | question | runs and time | data | results |
|---|---|---|---|---|
";
const AFTER: &str = "
*Times per run are those of the machines on the pages with results. [Data](../docs/data.md) explains how to get `data/`; \
scenes are simulated by the sweep. The test `experiments` of `pwrfgs-cli` makes this table from the headers.*
";

/// The experiments, sorted by name.
fn experiments() -> Vec<PathBuf> {
    let mut found: Vec<_> =
        std::fs::read_dir(root().join("experiments")).unwrap().map(|entry| entry.unwrap().path()).collect();
    found.retain(|path| path.extension().is_some_and(|ending| ending == "ron"));
    found.sort();
    found
}

/// The row of an experiment, from a header with a question, `Time: ..`, `Data: ..` and `Results: ..`.
fn row(path: &PathBuf) -> String {
    let (name, text) = (path.file_stem().unwrap().to_str().unwrap(), std::fs::read_to_string(path).unwrap());
    let header = text.lines().map_while(|line| line.strip_prefix("// ")).collect::<Vec<_>>().join(" ");
    let facts =
        r"^([^?]+\?)(?: .*)? Time: ((\d+) runs.*?)\. Data: (\S+), (measured|simulated)\. Results: (.+?)\.(?: |$)";
    let Some(facts) = Regex::new(facts).unwrap().captures(&header) else {
        panic!("{name}.ron: the header needs a question, `Time: N runs ..`, `Data: PATH, measured` and `Results: PAGE`")
    };
    let [question, time, runs, data, kind, results] = [1, 2, 3, 4, 5, 6].map(|i| facts[i].to_owned());
    let folder = tempfile::tempdir().unwrap();
    let status = stdout(&succeed(folder.path(), &["sweep", path.to_str().unwrap(), "--status"]));
    assert!(status.contains(&format!("0 of {runs} runs finished")), "{name}.ron has other runs than {runs}: {status}");
    let bases: Vec<String> = Regex::new("base: \"(.+?)\"")
        .unwrap()
        .captures_iter(&text)
        .map(|found| std::fs::read_to_string(root().join("experiments").join(&found[1])).unwrap())
        .collect();
    let reads = |base: &String| base.contains(&format!("\"../{data}\""));
    assert!(bases.iter().any(reads), "{name}.ron names {data}, which its pipeline does not read");
    assert_eq!(kind == "simulated", data.starts_with("scenes/") || data == "data/office-csi", "{name}.ron: {data}");
    let page = Regex::new(r"[\w/-]+\.md").unwrap();
    assert!(page.is_match(&results), "{name}.ron: no page in `{results}`");
    let results = page.replace_all(&results, |page: &regex::Captures<'_>| format!("[{0}](../{0})", &page[0]));
    format!("| [`{name}`]({name}.ron) | {question} | {time} | `{data}`, {kind} | {results} |")
}

#[test]
fn page_of_experiments_equals_their_headers() {
    let mut page = BEFORE.to_owned();
    experiments().iter().for_each(|path| writeln!(page, "{}", row(path)).unwrap());
    page += AFTER;
    let file = root().join("experiments/README.md");
    if std::env::var_os("PWRFGS_PAGES").is_some_and(|what| what == "write") {
        std::fs::write(&file, &page).unwrap();
    }
    let written = std::fs::read_to_string(&file).unwrap_or_default();
    assert!(written == page, "experiments/README.md differs from the headers; write it anew:\n{page}");
}

//! Claims of README, pages and headers against the tables that they summarise.

use crate::common::{call, stdout};
use crate::prose::{anchor, files, pages, root};
use regex::Regex;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn text(name: impl AsRef<Path>) -> String {
    std::fs::read_to_string(root().join(name)).unwrap()
}

/// Lines of the code blocks of a page, without their comments.
fn code(page: &str) -> Vec<&str> {
    let blocks = page.split("```").skip(1).step_by(2);
    blocks.flat_map(str::lines).map(|line| line.split(" #").next().unwrap().trim_end()).collect()
}

/// Means over three seeds of SSIM and η, from the row of `docs/lab/curve.md`; `None` without three seeds.
fn means(runs: &str, gaussians: &str, method: &str) -> Option<[f64; 2]> {
    let row = runs.lines().find(|line| line.starts_with(&format!("| {gaussians} | {method} |")))?;
    let seeds: Vec<Vec<(f64, usize)>> = row.split('|').skip(3).map(numbers).collect();
    (seeds[0].len() == 3).then(|| [0, 3].map(|column| seeds[column].iter().map(|(value, _)| value).sum::<f64>() / 3.0))
}

/// Cells of the row of a table that begins with `first`.
fn cells<'a>(page: &'a str, first: &str) -> Vec<&'a str> {
    let row = page.lines().find(|line| line.starts_with(&format!("| {first} |")));
    row.unwrap_or_else(|| panic!("no row {first}")).trim_matches('|').split('|').map(str::trim).collect()
}

/// Numbers of a text, with their decimals.
fn numbers(text: &str) -> Vec<(f64, usize)> {
    let number = Regex::new(r"\d+(?:,\d{3})*(?:\.(\d+))?").unwrap();
    let read = |found: regex::Captures<'_>| {
        (found[0].replace(',', "").parse().unwrap(), found.get(1).map_or(0, |digits| digits.len()))
    };
    number.captures_iter(text).map(read).collect()
}

/// Text below the heading that `link` names, such as `docs/data.md#s23`; without an anchor, the whole page.
fn section(link: &str) -> String {
    let (page, wanted) = link.split_once('#').unwrap_or((link, ""));
    let level = |line: &str| line.chars().take_while(|letter| *letter == '#').count();
    let (page, mut open) = (text(page), wanted.is_empty().then_some(0));
    let mut found = String::new();
    for line in page.lines() {
        match (level(line), open) {
            (1.., None) if anchor(line.trim_start_matches('#')) == wanted => open = Some(level(line)),
            (1.., Some(above @ 1..)) if level(line) <= above => break,
            (_, Some(_)) => found.extend([line, "\n"]),
            _ => {}
        }
    }
    assert!(!found.is_empty(), "{link} has no text");
    found
}

#[test]
fn curve_and_readme_state_means_of_the_runs() {
    let (readme, results, runs) = (text("README.md"), text("docs/results.md"), text("docs/lab/curve.md"));
    let figure = results.split("### Figure 2b").nth(1).unwrap().split("\n### ").next().unwrap();
    let head = cells(figure, "N");
    // The page rounds the seeds, too.
    let is_mean = |cell: &str, mean: f64, rounding: f64| (numbers(cell)[0].0 - mean).abs() < rounding;
    for gaussians in ["500", "157", "80", "24", "8"] {
        let row = cells(figure, gaussians);
        for method in ["`LearnableMask`", "`LightGaussian`", "WRF-GS"] {
            let cell = row[head.iter().position(|name| *name == method).unwrap()];
            let mean = means(&runs, gaussians, method).map(|[ssim, _]| ssim);
            let is_right = mean.map_or(cell.is_empty(), |mean| is_mean(cell, mean, 2e-4));
            assert!(is_right, "N = {gaussians}, {method}: {cell}, expected {mean:?}");
        }
    }
    let masks = |gaussians| means(&runs, gaussians, "`LearnableMask`").unwrap();
    let claim = cells(&results, "SSIM and η at N = 8")[2];
    let [ssim, eta] = masks("8");
    let (stated, rate) = claim.split_once(", ").unwrap();
    assert!(is_mean(stated, ssim, 2e-4) && is_mean(rate, eta, 6e-4), "{claim}, expected {ssim} and {eta}");
    let sentence = Regex::new(r"Learned masks reach ([\d.]+) SSIM with 157 Gaussians and ([\d.]+) with 8 ").unwrap();
    let stated = sentence.captures(&readme).expect("README states no SSIM of learned masks");
    assert!(is_mean(&stated[1], masks("157")[0], 2e-4) && is_mean(&stated[2], ssim, 2e-4), "{}", &stated[0]);
}

#[test]
fn readme_compares_times_as_the_table_does() {
    let results = text("docs/results.md");
    let times = |row: &str| -> (String, Vec<f64>) {
        let row = results.lines().find(|line| line.starts_with(row)).unwrap();
        let cell = row.split(" | ").nth(3).unwrap();
        (format!("{cell} ms"), cell.split(" to ").map(|time| time.parse().unwrap()).collect())
    };
    let rows = ["| `s23-laptop.ron` | 157", "| Kriging on s23", "| 5-NN on s23"];
    let [(model, own), (kriging, others), (neighbours, _)] = rows.map(times);
    assert!(own[0] > others[1], "the model is not slower than Kriging any more");
    let stated = format!("| **{kriging}** (Kriging), **{neighbours}** (5-NN) | {model} |");
    assert!(text("README.md").contains(&stated), "README lacks: {stated}");
}

#[test]
fn numbers_beside_interpolation_stand_in_the_sections_that_readme_links() {
    let (readme, link) = (text("README.md"), Regex::new(r"\]\((docs/[^)]+)\)").unwrap());
    let table = readme.split("## Why not interpolation?").nth(1).unwrap().split("\n## ").next().unwrap();
    let rows: Vec<&str> = table.lines().filter(|line| line.starts_with("| ") && line.contains("](docs/")).collect();
    assert_eq!(rows.len(), 6, "{rows:#?}");
    for row in rows {
        let sections = link.captures_iter(row).map(|found| section(&found[1]));
        let known: Vec<f64> = sections.flat_map(|text| numbers(&text)).map(|(number, _)| number).collect();
        let row = link.replace_all(row, "]");
        let unit = |number: f64| if row.contains(&format!("{number} MB")) { 1e6 } else { 1.0 };
        let stated: Vec<_> = numbers(&row).into_iter().filter(|(_, decimals)| *decimals > 0).collect();
        assert!(!stated.is_empty(), "no numbers in {row}");
        for (number, decimals) in stated {
            let rounding = 0.5 / 10f64.powi(decimals as i32) + 1e-9;
            let stands = known.iter().any(|other| (other / unit(number) - number).abs() <= rounding);
            assert!(stands, "README states {number}, which its links do not: {row}");
        }
    }
}

#[test]
fn comments_and_pages_state_what_the_paper_and_the_scene_have() {
    let mask = stdout(&call(&root(), &["plugins", "LearnableMask"]));
    let words = mask.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains("The threshold of 0.01 is that of the paper."), "{words}");
    let results = text("docs/results.md");
    let carriers = results.split("### Several carriers").nth(1).unwrap().split("\n## ").next().unwrap();
    assert!(carriers.contains("The array shrinks with the wavelength"));
}

#[test]
fn readme_links_its_terms_where_they_first_occur() {
    let readme = text("README.md");
    let prose: Vec<&str> = readme.lines().filter(|line| !line.starts_with("![")).collect();
    for term in ["noise ceiling", "Kriged residuals", "Kriging"] {
        let line = prose.iter().find(|line| line.contains(term)).unwrap();
        assert!(line.contains(&format!("[{term}](docs/")), "{term} is not linked where it first occurs: {line}");
    }
    assert!(!readme.contains("residuals Kriged"), "one thing has one name");
}

#[test]
fn readme_names_the_commands_of_a_clone() {
    let readme = text("README.md");
    let commands = code(&readme);
    assert!(commands.contains(&"tests/all.sh"), "no test command: {commands:#?}");
    assert!(
        text(".ci/run").lines().any(|line| line == "tests/all.sh"),
        ".ci/run does not call it as it stands in README"
    );
    assert!(readme.contains("cargo run --release --locked -- run quickstart\n"));
    // The package that cargo runs in the root, with one program. `shipped.rs` runs the quickstart.
    assert!(text("Cargo.toml").contains("\ndefault-members = [\"crates/cli\"]\n"));
    assert_eq!(text("crates/cli/Cargo.toml").matches("[[bin]]").count(), 1);
}

#[test]
fn release_counts_the_crates() {
    let crates = text("Cargo.toml").lines().filter(|line| line.contains(" = { path = \"")).count();
    assert!(text("CONTRIBUTING.md").contains(&format!("environment `crates-io` for each of the {crates} crates")));
}

#[test]
fn readme_cites_software_and_paper() {
    let (readme, citation) = (text("README.md"), text("CITATION.cff"));
    let title = Regex::new("(?m)^    title: \"(P-WRFGS.*)\"$").unwrap().captures(&citation).unwrap()[1].to_owned();
    for part in ["@software{", "@misc{", &title, concat!("version = {", env!("CARGO_PKG_VERSION"), "}"), "2605.15324"] {
        assert!(code(&readme).iter().any(|line| line.contains(part)), "no `{part}` in the BibTeX of README");
    }
}

#[test]
fn every_cargo_install_is_locked() {
    let mut found: Vec<PathBuf> = [".ci/run", "tests/all.sh", "tests/python.sh"].map(|name| root().join(name)).into();
    [".md", ".ron", ".py"].iter().for_each(|ending| files(&root(), ending, &mut found));
    files(&root().join(".github/workflows"), ".yml", &mut found);
    let command = Regex::new("cargo install [^\n`]*").unwrap();
    let texts: Vec<String> = found.iter().map(|path| std::fs::read_to_string(path).unwrap()).collect();
    let commands: Vec<&str> =
        texts.iter().flat_map(|text| command.find_iter(text)).map(|found| found.as_str()).collect();
    assert!(commands.len() >= 4, "{commands:#?}");
    let free: Vec<_> = commands.iter().filter(|command| !command.contains("--locked")).collect();
    assert!(free.is_empty(), "other crates than those of Cargo.lock: {free:#?}");
}

/// Parts of placeholders that CONTRIBUTING.md does not list.
const OTHERS: [&str; 10] =
    [" TODO", " FIXME", " TBD", " XXX", "orem ipsum", "://example.", "@example.", "our name>", "hangeme", "zenodo.X"];

#[test]
fn placeholders_are_those_that_contributing_lists() {
    // This text and the list itself name them, too.
    let outside = ["CONTRIBUTING.md", "crates/cli/tests/claims.rs"];
    let mut found = Vec::new();
    for ending in [".md", ".toml", ".cff", ".yml", ".rs", ".py", ".js", ".ron", ".sh", ".ipynb", "LICENSE-MIT"] {
        files(&root(), ending, &mut found);
    }
    files(&root().join(".github"), "", &mut found);
    let texts: Vec<(String, String)> = found
        .iter()
        .map(|path| (path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned(), path))
        .filter(|(name, _)| !outside.contains(&&**name))
        .map(|(name, path)| (name, std::fs::read_to_string(path).unwrap()))
        .collect();
    assert!(texts.len() > 300, "only {} files", texts.len());

    let contributing = text("CONTRIBUTING.md");
    let row = Regex::new(r"(?m)^\| (?:name|address) \| `([^`]+)` \| (.+) \|$").unwrap();
    for row in row.captures_iter(&contributing) {
        let listed: BTreeSet<&str> = row[2].split(", ").map(|file| file.trim_matches('`')).collect();
        let holding = texts.iter().filter(|(_, text)| text.contains(&row[1])).map(|(name, _)| &**name).collect();
        assert_eq!(listed, holding, "files with `{}`; correct the list in CONTRIBUTING.md", &row[1]);
    }
    let listed: Vec<String> = row.captures_iter(&contributing).map(|row| row[1].to_owned()).collect();
    let line = |(name, text): &(String, String)| {
        let is_other = |line: &&str| OTHERS.iter().any(|word| line.contains(word));
        let lines = text.lines().filter(is_other).filter(|line| !listed.iter().any(|known| line.contains(known)));
        lines.map(|line| format!("{name}: {line}")).collect::<Vec<_>>()
    };
    let has_other = |(_, text): &&(String, String)| OTHERS.iter().any(|word| text.contains(word));
    let wrong: Vec<String> = texts.iter().filter(has_other).flat_map(line).collect();
    assert!(wrong.is_empty(), "placeholders that CONTRIBUTING.md does not list: {wrong:#?}");
}

#[test]
fn headers_name_pages_that_have_their_results() {
    let mut found = Vec::new();
    ["experiments", "pipelines"].iter().for_each(|folder| files(&root().join(folder), ".ron", &mut found));
    let (page, file) = (Regex::new(r"docs/[\w/-]+\.md").unwrap(), Regex::new(r"([\w-]+)\.ron").unwrap());
    let (mut followed, mut wrong) = (0, Vec::new());
    for path in found {
        let own = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let header = std::fs::read_to_string(&path).unwrap();
        let header = header.lines().take_while(|line| line.starts_with("//")).collect::<Vec<_>>().join("\n");
        let named = file.captures_iter(&header).map(|found| found[1].to_owned());
        let names: Vec<String> = named.chain([own.clone()]).collect();
        // Pages of data and advice hold no results.
        let others = ["docs/data.md", "docs/simulator.md", "docs/guide.md"];
        for page in page.find_iter(&header).map(|found| found.as_str()).filter(|page| !others.contains(page)) {
            followed += 1;
            let content = text(page);
            let is_named = |name: &String| {
                let mark = format!(r"[`/ ]{name}(\.ron)?[` ,)]");
                Regex::new(&mark).unwrap().is_match(&content)
            };
            if !names.iter().any(is_named) {
                wrong.push(format!("{own}.ron names {page}, which does not name it"));
            }
        }
    }
    assert!(followed > 30, "only {followed} pages named");
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn scores_of_kriged_residuals_have_their_share() {
    let (name, score) =
        (Regex::new("esiduals Kriged|Kriged residuals").unwrap(), Regex::new(r"\| \**-?\d+\.\d{2}").unwrap());
    for page in pages() {
        let content = std::fs::read_to_string(&page).unwrap();
        let rows = content.lines().filter(|line| line.starts_with('|') && name.is_match(line) && score.is_match(line));
        for row in rows {
            assert!(row.contains("b = "), "{}: a score without the share b of the model: {row}", page.display());
        }
    }
}

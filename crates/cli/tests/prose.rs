//! Style and links of pages, help texts, and doc comments of plugins and code.
//!
//! The rules are in CONTRIBUTING.md, chapter "Writing".

use crate::common::{call, stdout};
use regex::Regex;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Words that mark a sentence with a hidden subject, an idle verb or a dropped noun.
const MARKERS: &str = r"(?i-u)\b(?:(?:is|are|was|were|be) (?:told|heard|taken|looked at|said|asked|held against|known|made anew|read back)|who|whoever|nobody|somebody|anything|(?:stands?|lies?) (?:in|at|on|for|beside|there|where|nearest|near|next|below|still)|goes? on|what (?:is|was|it|they|are|were|a|the|no|one|two|all|each|stands|lies|has|cannot)|of one's own|(?:says|say|tells?) (?:so|of|it|where|what|how|nothing|why)|(?:has|have) (?:the|a|its) [a-z]+ of its own|at hand|in no ranking|where you stand|beside)\b";
/// Markers per 1,000 words in texts for users, and in other doc comments.
const FOR_USERS: f64 = 3.0;
const IN_CODE: f64 = 5.0;
/// Commands whose help is counted.
const COMMANDS: &[&str] = &[
    "check",
    "compare",
    "data",
    "evaluate",
    "export",
    "export-scene",
    "import",
    "init",
    "inspect",
    "locate",
    "map",
    "pipelines",
    "place",
    "plan",
    "plugins",
    "predict",
    "report",
    "run",
    "simulate",
    "sweep",
    "update",
    "view",
];

pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// All files below `folder` with the ending, without build outputs and data.
pub(crate) fn files(folder: &Path, ending: &str, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let (path, name) = (entry.path(), entry.file_name().into_string().unwrap());
        if path.is_dir()
            && !path.is_symlink()
            && !name.starts_with('.')
            && !["target", "data", "runs"].contains(&&*name)
        {
            files(&path, ending, found);
        } else if name.ends_with(ending) && name != "reference.md" {
            found.push(path);
        }
    }
}

pub(crate) fn pages() -> Vec<PathBuf> {
    let mut found = Vec::new();
    files(&root(), ".md", &mut found);
    found.sort();
    found
}

/// Lines of Markdown outside code blocks and pictures.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut code = false;
    text.lines().filter(move |line| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        !code && !fence && !line.trim_start().starts_with("![")
    })
}

/// Counts words and markers, and collects the lines with the most markers.
struct Count {
    code: Regex,
    address: Regex,
    word: Regex,
    marker: Regex,
    words: usize,
    markers: usize,
    worst: Vec<(usize, String)>,
}

impl Count {
    fn new() -> Self {
        let regex = |pattern| Regex::new(pattern).unwrap();
        Self {
            code: regex("`[^`]*`"),
            address: regex(r"\]\([^)]*\)|https?://\S+"),
            word: regex("(?-u)[A-Za-z]{2,}"),
            marker: regex(MARKERS),
            words: 0,
            markers: 0,
            worst: Vec::new(),
        }
    }

    fn add(&mut self, source: &str, line: &str) {
        let plain = self.code.replace_all(line, "X");
        let plain = self.address.replace_all(&plain, "]");
        self.words += self.word.find_iter(&plain).count();
        let markers = self.marker.find_iter(&plain).count();
        self.markers += markers;
        if markers > 0 {
            self.worst.push((markers, format!("{source}: {}", line.trim())));
        }
    }

    /// # Panics
    /// Above `limit` markers per 1,000 words, with the ten worst lines.
    fn hold(mut self, texts: &str, limit: f64) {
        let rate = 1_000.0 * self.markers as f64 / self.words.max(1) as f64;
        println!("{texts}: {} markers in {} words, {rate:.1} per 1,000", self.markers, self.words);
        self.worst.sort_by_key(|(markers, _)| std::cmp::Reverse(*markers));
        let worst: Vec<_> = self.worst.iter().take(10).map(|(_, line)| line.as_str()).collect();
        assert!(self.words > 1_000, "{texts}: only {} words found", self.words);
        assert!(
            rate <= limit,
            "{texts}: {rate:.1} markers per 1,000 words, at most {limit} are accepted; rewrite by CONTRIBUTING.md, chapter \
             \"Writing\", first of all:\n{}",
            worst.join("\n")
        );
    }
}

#[test]
fn pages_help_and_plugin_comments_use_plain_language() {
    let mut count = Count::new();
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        let name = page.strip_prefix(root()).unwrap().display().to_string();
        prose(&text).for_each(|line| count.add(&name, line));
    }
    count.hold("Markdown pages", FOR_USERS);

    let mut count = Count::new();
    let print = |arguments: &[&str]| stdout(&call(&root(), arguments));
    let helps = COMMANDS.iter().map(|command| (format!("pwrfgs {command} --help"), print(&[command, "--help"])));
    for (name, text) in helps.chain([("pwrfgs --help".into(), print(&["--help"]))]) {
        text.lines().for_each(|line| count.add(&name, line));
    }
    count.hold("help", FOR_USERS);

    let mut count = Count::new();
    let reference = print(&["plugins", "--markdown"]);
    prose(&reference).for_each(|line| count.add("pwrfgs plugins --markdown", line));
    count.hold("comments of plugins and settings", FOR_USERS);
}

#[test]
fn doc_comments_use_plain_language() {
    let (mut sources, mut count) = (Vec::new(), Count::new());
    files(&root(), ".rs", &mut sources);
    for source in sources {
        let text = std::fs::read_to_string(&source).unwrap();
        let name = source.strip_prefix(root()).unwrap().display().to_string();
        let comments: Vec<&str> = text
            .lines()
            .filter_map(|line| line.trim_start().strip_prefix("///").or_else(|| line.trim_start().strip_prefix("//!")))
            .collect();
        prose(&comments.join("\n")).for_each(|line| count.add(&name, line));
    }
    count.hold("doc comments", IN_CODE);
}

/// The anchor that a heading gets on a page: lower case, hyphens for spaces, no punctuation.
pub(crate) fn anchor(heading: &str) -> String {
    let letters =
        heading.trim().to_lowercase().chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c)).collect::<String>();
    letters.replace(' ', "-")
}

#[test]
fn links_between_pages_resolve_to_files_and_headings() {
    let link = Regex::new(r"\]\(([^)\s]+)\)").unwrap();
    let code = Regex::new("`[^`]*`").unwrap();
    let anchors = |page: &Path| -> BTreeSet<String> {
        let text = std::fs::read_to_string(page).unwrap();
        let headings = prose(&text).filter(|line| line.starts_with('#'));
        let mut found = BTreeSet::new();
        for heading in headings.map(|h| anchor(h.trim_start_matches('#'))) {
            let again = (0..).map(|i| if i == 0 { heading.clone() } else { format!("{heading}-{i}") });
            found.insert(again.into_iter().find(|a| !found.contains(a)).unwrap());
        }
        found
    };
    let (mut followed, mut broken) = (0, Vec::new());
    for page in pages() {
        let text = std::fs::read_to_string(&page).unwrap();
        for line in prose(&text) {
            let line = code.replace_all(line, "X");
            for target in link.captures_iter(&line).map(|found| found[1].to_owned()) {
                if target.contains("://") || target.starts_with("mailto:") {
                    continue;
                }
                followed += 1;
                let (file, heading) = target.split_once('#').map_or((&*target, None), |(file, h)| (file, Some(h)));
                let file = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
                // Pages of the site.
                let generated = file.ends_with("docs/reference.md")
                    || file.ends_with("python/api/index.md")
                    || file.extension().is_some_and(|e| e == "html");
                let known = heading.is_none_or(|h| file.is_file() && anchors(&file).contains(h));
                if !(generated || file.exists() && known) {
                    broken.push(format!("{}: {target}", page.strip_prefix(root()).unwrap().display()));
                }
            }
        }
    }
    assert!(followed > 50, "only {followed} links found");
    assert!(broken.is_empty(), "links that lead nowhere; mend them or the headings:\n{}", broken.join("\n"));
}

#[test]
fn site_lists_every_page_once() {
    let summary = std::fs::read_to_string(root().join("site/SUMMARY.md")).unwrap();
    let outside = ["site/SUMMARY.md", "crates"];
    let listed = |page: &Path| {
        let name = page.strip_prefix(root()).unwrap();
        let own = name.strip_prefix("site").map_or_else(|_| Path::new("..").join(name), Path::to_owned);
        outside.iter().any(|folder| name.starts_with(folder))
            || summary.matches(&format!("]({})", own.display())).count() == 1
    };
    let missing: Vec<PathBuf> = pages().into_iter().filter(|page| !listed(page)).collect();
    assert!(missing.is_empty(), "site/SUMMARY.md does not list these pages once: {missing:?}");
}

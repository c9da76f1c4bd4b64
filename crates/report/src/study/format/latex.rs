//! `report.tex` and a file for each table, with booktabs: best is bold, second best underlined.
//!
//! A table's file needs the packages booktabs, graphicx and textcomp, and UTF-8 input; a table that is wider than the
//! text is scaled down to it.

use super::super::page::{Page, Section};
use super::super::tables::{Line, Mark, Shown, Table};
use std::fmt::Write as _;

const PREAMBLE: &str = r"\documentclass[11pt,a4paper]{article}
\usepackage[utf8]{inputenc}
\usepackage[T1]{fontenc}
\IfFileExists{lmodern.sty}{\usepackage{lmodern}}{}
\usepackage{textcomp}
\usepackage[margin=22mm]{geometry}
\usepackage{booktabs}
\usepackage{graphicx}
\emergencystretch=3em
";

/// What every table needs; said again in each of them, so that each can be read into another document.
const FIT: &str = r"\providecommand{\pwrfgsfit}[1]{\sbox0{#1}\ifdim\wd0>\linewidth\resizebox{\linewidth}{!}{\usebox0}\else\usebox0\fi}
";

/// The document that shows every table and figure.
pub(in super::super) fn document(page: &Page) -> String {
    let mut out =
        format!("{PREAMBLE}\\title{{{}}}\n\\date{{}}\n\\begin{{document}}\n\\maketitle\n", escaped(&page.title));
    for section in &page.sections {
        out.push_str(&of_section(section));
    }
    if !page.left_out.is_empty() {
        out.push_str("\\section*{Not in this report}\n");
        out.push_str(&list(page.left_out.iter().map(|why| escaped(why))));
    }
    out + "\\end{document}\n"
}

fn of_section(section: &Section) -> String {
    let mut out = format!("\\section{{{}}}\n{}\n", escaped(&section.title), escaped(&section.lead));
    for warning in &section.warnings {
        _ = write!(out, "\n\\textbf{{Warning:}} {}\n", escaped(warning));
    }
    for table in &section.tables {
        _ = writeln!(out, "\\input{{tables/{}-{}}}", section.name, table.name);
    }
    for figure in &section.figures {
        // As wide as it was drawn, where there is room.
        let drawn = super::width_mm(&figure.svg).unwrap_or(1e3);
        _ = write!(
            out,
            "\\begin{{figure}}[htbp]\n\\centering\n\\includegraphics[width=\\dimexpr\\ifdim{drawn}mm>\\linewidth\\linewidth\
             \\else{drawn}mm\\fi\\relax,height=.8\\textheight,keepaspectratio]{{figures/{0}-{1}.png}}\n\
             \\caption{{{2}. {3}}}\n\\label{{fig:{0}-{1}}}\n\\end{{figure}}\n",
            section.name,
            figure.name,
            escaped(&figure.title),
            escaped(&figure.caption)
        );
    }
    out.push_str("\\clearpage\n\\subsection*{Runs}\n{\\small\\raggedright\n");
    out.push_str(&list(section.runs.iter().map(|run| {
        let said = [&run.training, &run.machine, &run.program, &run.finished, &run.folder].map(|f| escaped(f));
        format!("{}, seed {}: {}", escaped(&run.variant), run.seed, said.join("; "))
    })));
    out.push_str("}\n");
    out.extend(section.notes.iter().map(|note| format!("\n{}\n", escaped(note))));
    out
}

fn list(items: impl Iterator<Item = String>) -> String {
    let items: Vec<String> = items.collect();
    format!("\\begin{{itemize}}\n\\item {}\n\\end{{itemize}}\n", items.join("\n\\item "))
}

/// One table as a float, to be read by `\input`; it names the setting, because it may stand anywhere.
pub(in super::super) fn table(table: &Table, section: &Section) -> String {
    let mut out = format!(
        "{FIT}\\begin{{table}}[htbp]\n\\centering\n\\caption{{{}: {}}}\n\\label{{tab:{}-{}}}\n\\pwrfgsfit{{%\n\
         \\begin{{tabular}}{{l{}}}\n\\toprule\n{}",
        escaped(&table.title),
        escaped(&section.title),
        section.name,
        table.name,
        "r".repeat(table.columns.len()),
        heads(table)
    );
    for lines in table.sections() {
        out.push_str("\\midrule\n");
        out.extend(lines.iter().map(line));
    }
    let legend: Vec<String> = table.legend.iter().map(|sentence| escaped(sentence)).collect();
    let how = if table.is_marked() { " \\textbf{Best}, \\underline{second best}." } else { "" };
    _ = write!(
        out,
        "\\bottomrule\n\\end{{tabular}}}}\n\n\\smallskip\n\\parbox{{\\linewidth}}{{\\footnotesize {}{how}}}\n\
         \\end{{table}}\n",
        legend.join(" ")
    );
    out
}

/// Titles over the columns they span, and statistics and units below.
fn heads(table: &Table) -> String {
    let (mut titles, mut rules, mut place) = (String::new(), String::new(), 2);
    for (column, span) in table.groups() {
        let title = format!("{} {}", escaped(&column.title), escaped(column.arrow));
        _ = write!(titles, " & \\multicolumn{{{span}}}{{{}}}{{{}}}", if span > 1 { "c" } else { "r" }, title.trim());
        if span > 1 {
            _ = writeln!(rules, "\\cmidrule(lr){{{place}-{}}}", place + span - 1);
        }
        place += span;
    }
    let details: Vec<String> = table.columns.iter().map(|c| escaped(&c.detail)).collect();
    let has_details = details.iter().any(|d| !d.is_empty());
    let details = if has_details { format!(" & {} \\\\\n", details.join(" & ")) } else { String::new() };
    format!("{titles} \\\\\n{rules}{details}")
}

fn line(line: &Line) -> String {
    let cells: Vec<String> = [escaped(&line.label)].into_iter().chain(line.cells.iter().map(cell)).collect();
    format!("{} \\\\\n", cells.join(" & "))
}

fn cell(shown: &Shown) -> String {
    if shown.value.is_empty() {
        return "--".into();
    }
    let value = escaped(&shown.value);
    let value = match shown.mark {
        Mark::None => value,
        Mark::Best => format!("\\textbf{{{value}}}"),
        Mark::Second => format!("\\underline{{{value}}}"),
        Mark::Clear => format!("{value}*"),
    };
    match (&shown.interval, shown.deviation.as_str()) {
        (Some((low, high)), _) => format!("{value} {{\\small [{}, {}]}}", escaped(low), escaped(high)),
        (None, "") => value,
        (None, deviation) => format!("{value} {{\\small$\\pm$\\,{}}}", escaped(deviation)),
    }
}

/// Text that LaTeX takes as it is. Letters that the T1 fonts lack are written by their number.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '\\' => out.push_str("\\textbackslash{}"),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '<' => out.push_str("\\textless{}"),
            '>' => out.push_str("\\textgreater{}"),
            '|' => out.push_str("\\textbar{}"),
            '"' => out.push_str("\\textquotedbl{}"),
            // Two in a row would become one long dash, or a quotation mark.
            '-' => out.push_str("-{}"),
            '\'' => out.push_str("\\textquotesingle{}"),
            '`' => out.push_str("\\textasciigrave{}"),
            '/' => out.push_str("/\\allowbreak{}"),
            '[' => out.push_str("{[}"),
            ']' => out.push_str("{]}"),
            ' '..='~' => out.push(c),
            _ => match symbol(c) {
                Some(math) => _ = write!(out, "\\ensuremath{{{math}}}"),
                // Latin-1 and Latin Extended-A but for the few that T1 has no command for.
                None if ('\u{a1}'..='\u{17e}').contains(&c) && !"ĦħĸĿŀŉŦŧ".contains(c) => out.push(c),
                None if "–—‘’“”…†‡•".contains(c) => out.push(c),
                None if c.is_whitespace() => out.push(' '),
                None => _ = write!(out, "{{[}}U+{:04X}{{]}}", u32::from(c)),
            },
        }
    }
    out
}

/// A letter or sign that only formulas have.
fn symbol(c: char) -> Option<&'static str> {
    Some(match c {
        '−' => "-",
        '±' => "\\pm",
        '×' => "\\times",
        '·' => "\\cdot",
        '°' => "^\\circ",
        '²' => "^2",
        '³' => "^3",
        '∞' => "\\infty",
        '≤' => "\\le",
        '≥' => "\\ge",
        '≈' => "\\approx",
        '→' => "\\rightarrow",
        '↑' => "\\uparrow",
        '↓' => "\\downarrow",
        '√' => "\\surd",
        '∈' => "\\in",
        'Δ' => "\\Delta",
        'Σ' => "\\Sigma",
        'Ω' => "\\Omega",
        'Φ' => "\\Phi",
        'α' => "\\alpha",
        'β' => "\\beta",
        'γ' => "\\gamma",
        'δ' => "\\delta",
        'ε' => "\\varepsilon",
        'η' => "\\eta",
        'θ' => "\\theta",
        'λ' => "\\lambda",
        'μ' | 'µ' => "\\mu",
        'ν' => "\\nu",
        'π' => "\\pi",
        'ρ' => "\\rho",
        'σ' => "\\sigma",
        'τ' => "\\tau",
        'φ' => "\\varphi",
        'ψ' => "\\psi",
        'ω' => "\\omega",
        '¹' => "^1",
        '⁻' => "^-",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::super::super::tables::{Column, Section as Rows};
    use super::*;

    #[test]
    fn every_special_character_is_escaped() {
        let found = escaped(r"\ { } $ & # ^ _ % ~");
        let expected = r"\textbackslash{} \{ \} \$ \& \# \textasciicircum{} \_ \% \textasciitilde{}";
        assert_eq!(found, expected);
        assert_eq!(escaped("RT ±20% λ=0.1 --x"), "RT \\ensuremath{\\pm}20\\% \\ensuremath{\\lambda}=0.1 -{}-{}x");
        assert_eq!(escaped("«ü» 模"), "«ü» {[}U+6A21{]}");
    }

    #[test]
    fn a_table_has_rules_groups_and_marks() {
        let column = |title: &str, detail: &str| Column { title: title.into(), detail: detail.into(), arrow: "↑" };
        let shown = |value: &str, mark| Shown { value: value.into(), mark, ..Shown::default() };
        let line = |label: &str, section, cells| Line { label: label.into(), section, cells };
        let table = super::table(
            &Table {
                name: "scores",
                title: "50 % of a_b".into(),
                columns: vec![column("SSIM", "mean"), column("SSIM", "median"), column("η", "mean")],
                lines: vec![
                    line(
                        "a_b",
                        Rows::Variants,
                        vec![shown("0.9", Mark::Best), shown("1", Mark::None), Shown::default()],
                    ),
                    line(
                        "5-NN",
                        Rows::Floors,
                        vec![shown("0.8", Mark::Second), shown("1", Mark::None), Shown::default()],
                    ),
                ],
                legend: vec![],
            },
            &Section { name: "1".into(), title: "office (simulated)".into(), ..Section::default() },
        );
        for part in [
            "\\caption{50 \\% of a\\_b: office (simulated)}\n\\label{tab:1-scores}",
            "\\multicolumn{2}{c}{SSIM \\ensuremath{\\uparrow}} & \\multicolumn{1}{r}{\\ensuremath{\\eta}",
            "\\cmidrule(lr){2-3}\n & mean & median & mean \\\\\n\\midrule\n",
            "a\\_b & \\textbf{0.9} & 1 & -- \\\\\n\\midrule\n5-{}NN & \\underline{0.8} & 1 & -- \\\\\n\\bottomrule",
        ] {
            assert!(table.contains(part), "`{part}` is not in\n{table}");
        }
    }
}

//! The files of the page: plain modules without a build step.

/// Markup of the stage, the part of a page that moves.
pub const STAGE: &str = include_str!("../../web/stage.html");
/// Its style.
pub const STYLE: &str = include_str!("../../web/stage.css");
/// Modules by name, each after those that it imports.
pub const FILES: [(&str, &str); 10] = [
    ("tensors.js", include_str!("../../web/tensors.js")),
    ("predict.js", include_str!("../../web/predict.js")),
    ("ssim.js", include_str!("../../web/ssim.js")),
    ("room.js", include_str!("../../web/room.js")),
    ("spectrum.js", include_str!("../../web/spectrum.js")),
    ("chart.js", include_str!("../../web/chart.js")),
    ("source.js", include_str!("../../web/source.js")),
    ("stage.js", include_str!("../../web/stage.js")),
    ("tables.js", include_str!("../../web/tables.js")),
    ("report.js", include_str!("../../web/report.js")),
];

/// All modules as one script, for a page that has nothing outside it: without their imports, and with `last` at the end.
pub fn bundle(last: &str) -> String {
    let mut script = String::from("\"use strict\";\n");
    for (_, text) in FILES {
        for line in text.lines().filter(|line| !line.starts_with("import ")) {
            script.push_str(line.strip_prefix("export ").unwrap_or(line));
            script.push('\n');
        }
    }
    script + last
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modules_become_one_script_and_each_has_its_own_names() {
        let script = bundle("start();");
        assert!(script.ends_with("start();") && !script.contains("\nimport ") && !script.contains("\nexport "));
        assert!(!script.contains("</script"), "a page would end there");
        let mut names: Vec<&str> = Vec::new();
        for line in script.lines() {
            let declared = ["function ", "class ", "const "].iter().find_map(|word| line.strip_prefix(word));
            let name = declared.map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or(""));
            names.extend(name.filter(|name| !name.is_empty()));
        }
        names.sort_unstable();
        let twice = names.windows(2).find(|pair| pair[0] == pair[1]);
        assert_eq!(twice, None, "two modules declare the same name, and a report has them in one script");
    }
}

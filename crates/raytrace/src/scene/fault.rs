//! What is wrong with a scene, and where it stands in the file.

/// What is wrong, and a word of the file near which it stands.
pub(super) struct Fault {
    pub(super) what: String,
    pub(super) near: String,
}

impl Fault {
    pub(super) fn of(what: impl Into<String>, near: &str) -> Self {
        Self { what: what.into(), near: near.into() }
    }
}

/// Line and column of the first place where `word` stands outside comments.
pub(super) fn place(text: &str, word: &str) -> Option<(usize, usize)> {
    text.lines().enumerate().find_map(|(i, line)| {
        let code = line.split("//").next().unwrap_or_default();
        code.find(word).map(|at| (i + 1, code[..at].chars().count() + 1))
    })
}

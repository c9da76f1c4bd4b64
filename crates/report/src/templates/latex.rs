//! Text that LaTeX takes as it is, with T1 fonts and textcomp.

/// Signs that mean something to LaTeX, each with what shows it. Two dashes in a row would become one long dash.
const SIGNS: &str = r#"
    \ \textbackslash{} ~ \textasciitilde{} ^ \textasciicircum{} & \& % \% $ \$ # \# _ \_ { \{ } \} < \textless{}
    > \textgreater{} | \textbar{} " \textquotedbl{} - -{} ' \textquotesingle{} ` \textasciigrave{} / /\allowbreak{}
    [ {[} ] {]}"#;

/// Letters and signs that only formulas have.
const SYMBOLS: &str = r"
    − - ± \pm × \times · \cdot ° ^\circ ² ^2 ³ ^3 ∞ \infty ≤ \le ≥ \ge ≈ \approx ≡ \equiv → \rightarrow ↑ \uparrow ↓ \downarrow
    √ \surd ∈ \in Δ \Delta Σ \Sigma Ω \Omega Φ \Phi α \alpha β \beta γ \gamma δ \delta ε \varepsilon η \eta θ \theta
    λ \lambda μ \mu µ \mu ν \nu π \pi ρ \rho σ \sigma τ \tau φ \varphi ψ \psi ω \omega ¹ ^1 ⁻ ^-";

/// What stands behind `c` in a list of pairs.
fn paired(list: &'static str, c: char) -> Option<&'static str> {
    let mut words = list.split_whitespace();
    while let (Some(key), Some(value)) = (words.next(), words.next()) {
        if key.chars().eq([c]) {
            return Some(value);
        }
    }
    None
}

/// Escapes a text. Letters that the fonts lack are written by their number.
pub(super) fn escaped(text: &str) -> String {
    let escape = |c: char| match (paired(SIGNS, c), paired(SYMBOLS, c)) {
        (Some(shown), _) => shown.to_owned(),
        (_, Some(symbol)) => format!("\\ensuremath{{{symbol}}}"),
        // Latin-1 and Latin Extended-A but for the few that T1 has no command for.
        _ if (' '..='~').contains(&c) || ('\u{a1}'..='\u{17e}').contains(&c) && !"ĦħĸĿŀŉŦŧ".contains(c) => {
            c.into()
        }
        _ if "–—‘’“”…†‡•".contains(c) => c.into(),
        _ if c.is_whitespace() => " ".into(),
        _ => format!("{{[}}U+{:04X}{{]}}", u32::from(c)),
    };
    text.chars().map(escape).collect()
}

#[cfg(test)]
mod tests {
    use super::escaped;

    #[test]
    fn every_special_character_is_escaped() {
        let found = escaped(r"\ { } $ & # ^ _ % ~");
        let expected = r"\textbackslash{} \{ \} \$ \& \# \textasciicircum{} \_ \% \textasciitilde{}";
        assert_eq!(found, expected);
        assert_eq!(escaped("RT ±20% λ=0.1 --x"), "RT \\ensuremath{\\pm}20\\% \\ensuremath{\\lambda}=0.1 -{}-{}x");
        assert_eq!(escaped("«ü» 模"), "«ü» {[}U+6A21{]}");
    }
}

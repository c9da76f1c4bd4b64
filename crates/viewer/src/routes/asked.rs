//! What stands behind the question mark of an address.

/// Everything that may be asked with.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Asked {
    pub(super) side: usize,
    pub(super) receiver: usize,
    /// A position in metres, world frame.
    pub(super) tx: Option<[f64; 3]>,
    /// A link of the data.
    pub(super) link: Option<usize>,
    /// A snapshot of the training.
    pub(super) moment: Option<usize>,
    /// Height of a plane, metres, world frame.
    pub(super) z: Option<f64>,
    /// What is wanted besides, such as `contribution`.
    pub(super) with: String,
}

impl Asked {
    /// Reads `side=0&tx=1,2,3`.
    ///
    /// # Errors
    /// The field that is wrong.
    pub(super) fn parse(query: &str) -> Result<Self, String> {
        let mut asked = Self::default();
        for pair in query.split('&').filter(|pair| !pair.is_empty()) {
            let (name, value) = pair.split_once('=').ok_or_else(|| format!("`{pair}` has no value"))?;
            let index = || value.parse::<usize>().map_err(|e| format!("`{name}`: {e}"));
            match name {
                "side" => asked.side = index()?,
                "receiver" => asked.receiver = index()?,
                "link" => asked.link = Some(index()?),
                "moment" => asked.moment = Some(index()?),
                "z" => asked.z = Some(metres(name, value)?),
                "tx" => {
                    let all: Vec<f64> = value.split(',').map(|v| metres(name, v)).collect::<Result<_, _>>()?;
                    asked.tx = Some(
                        all.try_into()
                            .map_err(|all: Vec<f64>| format!("`tx` wants x,y,z, not {} numbers", all.len()))?,
                    );
                }
                "with" => value.clone_into(&mut asked.with),
                _ => return Err(format!("`{name}` means nothing here")),
            }
        }
        Ok(asked)
    }
}

/// A number within what arithmetic in single precision bears.
fn metres(name: &str, value: &str) -> Result<f64, String> {
    let number = value.parse::<f64>().ok().filter(|v| v.abs() < 1e9);
    number.ok_or_else(|| format!("`{name}` wants metres"))
}

#[cfg(test)]
mod tests {
    use super::Asked;

    #[test]
    fn what_is_asked_is_read_or_refused() {
        let asked = Asked::parse("side=1&tx=1,-2.5,3e0&with=strength").unwrap();
        assert_eq!((asked.side, asked.tx, asked.with.as_str()), (1, Some([1.0, -2.5, 3.0]), "strength"));
        assert_eq!(Asked::parse("").unwrap(), Asked::default());
        for wrong in ["tx=1,2", "tx=1,2,nan", "tx=1,2,inf", "tx=1,2,1e30", "side=-1", "side", "link=x", "z=", "other=1"]
        {
            assert!(Asked::parse(wrong).is_err(), "{wrong}");
        }
    }
}

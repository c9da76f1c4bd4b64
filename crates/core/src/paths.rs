//! Paths in texts: as they are, but for bytes that are no UTF-8. Such a byte is written as a NUL and two hexadecimal
//! digits, `caf\0e9` for Latin-1 «café»: no path holds a NUL, so every text reads back to the path that it came from.
//!
//! A field of a plugin that holds a path says `#[serde(with = "pwrfgs_core::paths")]`, or `paths::optional`.

use serde::{Deserialize, Deserializer, Serializer, de::Error as _, ser::Error as _};
use std::path::{Path, PathBuf};

/// Writes a path.
///
/// # Errors
/// Where the system's paths are no bytes, and this one is no text.
pub fn serialize<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(&to_text(path).map_err(S::Error::custom)?)
}

/// Reads one.
///
/// # Errors
/// A NUL that no two hexadecimal digits follow.
pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<PathBuf, D::Error> {
    from_text(&String::deserialize(from)?).map_err(D::Error::custom)
}

/// The same of a path that may be absent.
pub mod optional {
    use super::{Deserialize, Deserializer, Path, PathBuf, Serializer};
    use serde::Serialize;

    #[derive(Serialize, Deserialize)]
    #[serde(transparent)]
    struct Text(#[serde(with = "super")] PathBuf);

    /// Writes it.
    ///
    /// # Errors
    /// As [`super::serialize`].
    pub fn serialize<S: Serializer>(path: &Option<PathBuf>, to: S) -> Result<S::Ok, S::Error> {
        path.as_deref().map(|path: &Path| Text(path.into())).serialize(to)
    }

    /// Reads it.
    ///
    /// # Errors
    /// As [`super::deserialize`].
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<PathBuf>, D::Error> {
        Ok(Option::<Text>::deserialize(from)?.map(|text| text.0))
    }
}

#[cfg(unix)]
#[expect(clippy::unnecessary_wraps, reason = "elsewhere it may fail")]
fn to_text(path: &Path) -> Result<String, &'static str> {
    use std::fmt::Write as _;
    use std::os::unix::ffi::OsStrExt as _;
    let mut text = String::new();
    for chunk in path.as_os_str().as_bytes().utf8_chunks() {
        text += chunk.valid();
        chunk.invalid().iter().for_each(|byte| _ = write!(text, "\0{byte:02x}"));
    }
    Ok(text)
}

#[cfg(unix)]
fn from_text(text: &str) -> Result<PathBuf, &'static str> {
    use std::os::unix::ffi::OsStringExt as _;
    let mut parts = text.split('\0');
    let mut bytes = parts.next().unwrap_or_default().as_bytes().to_vec();
    for part in parts {
        let byte = part.get(..2).and_then(|digits| u8::from_str_radix(digits, 16).ok());
        bytes.push(byte.ok_or("a NUL in a path stands for a byte and needs two hexadecimal digits after it")?);
        bytes.extend(&part.as_bytes()[2..]);
    }
    Ok(std::ffi::OsString::from_vec(bytes).into())
}

#[cfg(not(unix))]
fn to_text(path: &Path) -> Result<String, &'static str> {
    path.to_str().map(str::to_owned).ok_or("a path that is no text; rename the folder")
}

#[cfg(not(unix))]
fn from_text(text: &str) -> Result<PathBuf, &'static str> {
    Ok(text.into())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::plugin::ron_options;
    use serde::Serialize;
    use std::os::unix::ffi::OsStrExt as _;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Files {
        #[serde(with = "super")]
        root: PathBuf,
        #[serde(default, with = "super::optional")]
        other: Option<PathBuf>,
    }

    #[test]
    fn every_path_comes_back_and_ordinary_ones_look_as_ever() {
        let path = |bytes: &[u8]| PathBuf::from(std::ffi::OsStr::from_bytes(bytes));
        let cases: [&[u8]; 6] =
            [b"a/b", "h\u{fc}tte/\"x\"".as_bytes(), b"caf\xe9/data", b"\xff\xfe", b"\xe9e9 %E9", b""];
        for bytes in cases {
            for other in [None, Some(path(bytes))] {
                let files = Files { root: path(bytes), other };
                let text = ron_options().to_string(&files).unwrap();
                assert_eq!(ron_options().from_str::<Files>(&text).unwrap(), files, "{text}");
            }
        }
        let text = |bytes: &[u8]| ron_options().to_string(&Files { root: path(bytes), other: None }).unwrap();
        assert!(text(b"a/b").contains("\"a/b\""), "{}", text(b"a/b"));
        println!("{}", text(b"caf\xe9"));
        for wrong in ["a\\u{0}", "a\\u{0}x", "a\\u{0}\u{fc}\u{fc}"] {
            assert!(ron_options().from_str::<Files>(&format!("(root: \"{wrong}\")")).is_err(), "{wrong:?}");
        }
    }
}

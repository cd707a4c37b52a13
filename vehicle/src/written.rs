//! Parses the TOML files that people write.

use serde::de::DeserializeOwned;

/// Parses TOML. Unlike [`toml::from_str`], refuses a list with more entries than its type holds: a
/// file with six rotors is no quadrotor's.
///
/// # Errors
/// The text is not TOML, or does not follow the type.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, toml::de::Error> {
    // Parsed from the text first, because those errors show the place in it.
    let parsed = toml::from_str(text)?;
    toml::from_str::<toml::Table>(text)?.try_into::<T>()?;
    Ok(parsed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, serde::Deserialize)]
    struct Written {
        triple: [f64; 3],
    }

    #[test]
    fn a_list_that_is_too_long_is_refused_by_its_name() {
        assert_eq!(from_toml("triple = [1.0, 2.0, 3.0]"), Ok(Written { triple: [1.0, 2.0, 3.0] }));
        let error = from_toml::<Written>("triple = [1.0, 2.0, 3.0, 4.0]").unwrap_err().to_string();
        assert!(error.contains("length 4") && error.contains("triple"), "{error}");
        let error = from_toml::<Written>("triple = [1.0, 2.0]").unwrap_err().to_string();
        assert!(error.contains("line 1"), "{error}");
    }
}

//! Mapping files that are built into the program.

use std::borrow::Cow;
use std::io::ErrorKind;
use std::path::Path;

use vehicle::bounded;

use super::ImportError;

/// Name and text of each shipped mapping file.
pub const SHIPPED: [(&str, &str); 2] = [
    ("motion-capture", include_str!("../../../mappings/motion-capture.toml")),
    ("motive", include_str!("../../../mappings/motive.toml")),
];

/// The text of a mapping file, or of the shipped one of that name if there is no such file.
///
/// # Errors
/// The file cannot be read and no shipped mapping has that name.
pub(super) fn text(path: &Path) -> Result<Cow<'static, str>, ImportError> {
    let shipped = SHIPPED.iter().find(|(name, _)| Path::new(name) == path);
    match (bounded::read_to_string(path, bounded::WRITTEN_MAX), shipped) {
        (Ok(text), _) => Ok(text.into()),
        (Err(error), Some((_, text))) if error.kind() == ErrorKind::NotFound => Ok((*text).into()),
        (Err(error), _) if error.kind() == ErrorKind::NotFound => {
            let names: Vec<&str> = SHIPPED.iter().map(|(name, _)| *name).collect();
            let message = format!(
                "there is no such file, and no shipped mapping of that name; shipped mappings are \
                 {}",
                names.join(", ")
            );
            Err(ImportError::Mapping { path: path.to_owned(), message })
        }
        (Err(source), _) => Err(ImportError::Read { path: path.to_owned(), source }),
    }
}

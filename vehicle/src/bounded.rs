//! Reads whole files, with a limit on their size.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Size limit of a hand-written file, such as a vehicle file, in bytes. Its parsed values take
/// about a hundred times as much memory.
pub const WRITTEN_MAX: u64 = 4 << 20;

/// Reads a file of at most `most` bytes.
///
/// # Errors
/// The file cannot be read or is larger, which includes a file without an end.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let message = format!("the file is larger than {} MiB", most >> 20);
        return Err(io::Error::new(ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

/// Reads a UTF-8 text file of at most `most` bytes.
///
/// # Errors
/// As [`read`]; also if the bytes are not UTF-8.
pub fn read_to_string(path: &Path, most: u64) -> io::Result<String> {
    String::from_utf8(read(path, most)?).map_err(|_| {
        io::Error::new(ErrorKind::InvalidData, "expected text (UTF-8), found other bytes")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endless_file_is_refused_and_file_at_the_limit_is_read() {
        let path = std::env::temp_dir().join(format!("bounded-{}", std::process::id()));
        std::fs::write(&path, vec![b'a'; 2 << 20]).expect("a file");
        assert_eq!(read(&path, 2 << 20).expect("its bytes").len(), 2 << 20);
        let error = read_to_string(&path, (2 << 20) - 1).expect_err("too large");
        assert_eq!(error.kind(), ErrorKind::FileTooLarge);
        std::fs::remove_file(&path).expect("it was there");
        if cfg!(target_os = "linux") {
            let error = read(Path::new("/dev/zero"), 1 << 20).expect_err("it has no end");
            assert_eq!(error.to_string(), "the file is larger than 1 MiB");
        }
    }
}

//! Parameter files of QGroundControl (.params), Mission Planner (.param), MAVProxy (.parm) and
//! PX4's `param save` (BSON).

use std::collections::BTreeMap;

use super::Parameters;

/// Length limit of a parameter's name.
const NAME_MAX: usize = 16;

/// The file is not a parameter file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "no parameters: expected lines of NAME and value, as QGroundControl, Mission Planner and \
     MAVProxy write them, or what PX4's `param save` writes; {0}"
)]
pub struct NotParameters(String);

/// Parses a parameter file in any of the formats.
///
/// # Errors
/// [`NotParameters`] if a line or element fits no format, or the file has no parameters.
pub fn parse(bytes: &[u8]) -> Result<Parameters, NotParameters> {
    let values = match std::str::from_utf8(bytes) {
        Ok(text) if !is_bson(bytes) => text_lines(text)?,
        _ => bson(bytes).ok_or_else(|| NotParameters("it is neither text nor BSON".to_owned()))?,
    };
    if values.is_empty() {
        return Err(NotParameters("it has none".to_owned()));
    }
    Ok(values.into())
}

fn text_lines(text: &str) -> Result<BTreeMap<String, f64>, NotParameters> {
    let mut values = BTreeMap::new();
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let fields: Vec<&str> = line
            .split(|c: char| c == ',' || c == '=' || c.is_whitespace())
            .filter(|field| !field.is_empty())
            .collect();
        let found = match fields.as_slice() {
            // QGroundControl: system, component, name, value, type.
            [system, component, name, value, _kind]
                if system.parse::<u8>().is_ok() && component.parse::<u8>().is_ok() =>
            {
                pair(name, value)
            }
            // The third column may be a flag such as @READONLY.
            [name, value] | [name, value, _] => pair(name, value),
            _ => None,
        };
        let Some((name, value)) = found else {
            let line: String = line.chars().take(60).collect();
            return Err(NotParameters(format!("line {} is {line:?}", number + 1)));
        };
        values.insert(name, value);
    }
    Ok(values)
}

fn pair(name: &str, value: &str) -> Option<(String, f64)> {
    Some((name_of(name)?, value.parse().ok().filter(|value: &f64| value.is_finite())?))
}

fn name_of(name: &str) -> Option<String> {
    let is_name = !name.is_empty()
        && name.len() <= NAME_MAX
        && name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    is_name.then(|| name.to_owned())
}

fn is_bson(bytes: &[u8]) -> bool {
    bytes.len() > 5 && bytes.last() == Some(&0) && bytes.get(..4).is_some_and(|b| b.contains(&0))
}

/// Parses a BSON document: its length, then elements of a type, a name and a value, then 0.
fn bson(bytes: &[u8]) -> Option<BTreeMap<String, f64>> {
    let mut rest = bytes.get(4..)?;
    let mut values = BTreeMap::new();
    loop {
        let (kind, after) = rest.split_first()?;
        if *kind == 0 {
            return Some(values);
        }
        let end = after.iter().position(|byte| *byte == 0)?;
        let name = name_of(std::str::from_utf8(after.get(..end)?).ok()?)?;
        rest = after.get(end + 1..)?;
        let value = match kind {
            0x01 => f64::from_le_bytes(*rest.first_chunk::<8>()?),
            0x10 => f64::from(i32::from_le_bytes(*rest.first_chunk::<4>()?)),
            0x12 => i64::from_le_bytes(*rest.first_chunk::<8>()?) as f64,
            _ => return None,
        };
        rest = rest.get(if *kind == 0x10 { 4 } else { 8 }..)?;
        values.insert(name, value);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pairs(bytes: &[u8]) -> Vec<(String, f64)> {
        parse(bytes).expect("parameters").iter().map(|(n, v)| (n.clone(), *v)).collect()
    }

    #[test]
    fn every_ground_station_format_is_parsed() {
        let expected = [("MC_ROLL_P".to_owned(), 6.5), ("SYS_AUTOSTART".to_owned(), 4001.0)];
        let ground_control = "# Onboard parameters for Vehicle 1\n#\n\
            1\t1\tMC_ROLL_P\t6.500000000000000000\t9\n1\t1\tSYS_AUTOSTART\t4001\t6\n";
        let planner = "#NOTE: 1/2/2026\nMC_ROLL_P,6.5\r\nSYS_AUTOSTART,4001\r\n";
        let proxy = "MC_ROLL_P        6.500000\nSYS_AUTOSTART    4001 # start\n";
        for text in [ground_control, planner, proxy] {
            assert_eq!(pairs(text.as_bytes()), expected, "{text}");
        }
    }

    #[test]
    fn px4_bson_document_is_parsed() {
        let mut document = vec![0; 4];
        document.extend(b"\x10SYS_AUTOSTART\0");
        document.extend(4001i32.to_le_bytes());
        document.extend(b"\x01MC_ROLL_P\0");
        document.extend(6.5f64.to_le_bytes());
        document.push(0);
        let length = (document.len() as u32).to_le_bytes();
        document[..4].copy_from_slice(&length);
        let expected = [("MC_ROLL_P".to_owned(), 6.5), ("SYS_AUTOSTART".to_owned(), 4001.0)];
        assert_eq!(pairs(&document), expected);
        document.truncate(20);
        assert!(parse(&document).is_err());
    }

    #[test]
    fn file_without_parameters_is_refused_with_its_line() {
        let error = parse(b"# a\nname = \"crazyflie\"\n").unwrap_err().to_string();
        assert!(error.contains("line 2"), "{error}");
        assert!(parse(b"").unwrap_err().to_string().contains("it has none"));
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic_the_parser(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&bytes);
        }
    }
}

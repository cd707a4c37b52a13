//! Reads a crate's sources far enough to say which of its modules name which others.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

pub fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The Rust files below a folder of the repository, as paths from its root with `/`.
pub fn sources(folder: &str) -> Vec<String> {
    let mut found = Vec::new();
    for entry in fs::read_dir(root().join(folder)).expect("a source folder") {
        let entry = entry.expect("an entry");
        let path = format!("{folder}/{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            found.extend(sources(&path));
        } else if Path::new(&path).extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Identifiers and punctuation of a Rust file, without comments, literals and `#[cfg(test)]` items.
pub fn code(file: &str) -> Vec<String> {
    without_tests(&tokens(&fs::read_to_string(root().join(file)).expect("a source file")))
}

/// `::` is one token, and so is each other punctuation mark; text literals give none.
fn tokens(text: &str) -> Vec<String> {
    let bytes = text.as_bytes();
    let word = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
    let find = |from: usize, end: &str| text[from..].find(end).map_or(text.len(), |at| from + at);
    let (mut tokens, mut at) = (Vec::new(), 0);
    while at < bytes.len() {
        let rest = &text[at..];
        if rest.starts_with("//") {
            at = find(at, "\n");
        } else if rest.starts_with("/*") {
            let mut depth = 0;
            while at < bytes.len() {
                let step = match &bytes[at..] {
                    [b'/', b'*', ..] => 1,
                    [b'*', b'/', ..] => -1,
                    _ => 0,
                };
                depth += step;
                at += if step == 0 { 1 } else { 2 };
                if depth == 0 {
                    break;
                }
            }
        } else if bytes[at] == b'"' {
            at += 1;
            while at < bytes.len() && bytes[at] != b'"' {
                at += if bytes[at] == b'\\' { 2 } else { 1 };
            }
            at += 1;
        } else if let Some(hashes) = raw_string(rest) {
            let end = format!("\"{}", "#".repeat(hashes));
            at = find(find(at, "\"") + 1, &end) + end.len();
        } else if bytes[at] == b'\'' {
            // A character has its closing quote; a lifetime has none.
            let escaped = bytes.get(at + 1) == Some(&b'\\');
            let mut characters = rest[1..].chars();
            let length = characters.next().map_or(0, char::len_utf8);
            if escaped {
                at = find(at + 3, "'") + 1;
            } else if characters.next() == Some('\'') {
                at += length + 2;
            } else {
                at += 1;
            }
        } else if word(bytes[at]) {
            let end = bytes[at..].iter().position(|&b| !word(b)).map_or(bytes.len(), |n| at + n);
            tokens.push(text[at..end].to_owned());
            at = end;
        } else if rest.starts_with("::") {
            tokens.push("::".to_owned());
            at += 2;
        } else {
            if bytes[at].is_ascii_punctuation() {
                tokens.push(char::from(bytes[at]).to_string());
            }
            at += 1;
        }
    }
    tokens
}

/// The number of hashes of the raw string that starts `text`.
fn raw_string(text: &str) -> Option<usize> {
    let text = text.strip_prefix('b').unwrap_or(text).strip_prefix('r')?;
    let hashes = text.len() - text.trim_start_matches('#').len();
    text[hashes..].starts_with('"').then_some(hashes)
}

/// Removes each item with `#[cfg(test)]`, up to its semicolon or closing brace.
fn without_tests(tokens: &[String]) -> Vec<String> {
    let mark = ["#", "[", "cfg", "(", "test", ")", "]"];
    let (mut kept, mut at) = (Vec::new(), 0);
    while at < tokens.len() {
        if !tokens[at..].iter().take(mark.len()).eq(mark.iter()) {
            kept.push(tokens[at].clone());
            at += 1;
            continue;
        }
        let (mut depth, mut attribute) = (0, true);
        at += mark.len();
        while at < tokens.len() {
            let token = tokens[at].as_str();
            attribute &= depth > 0 || token == "#" || token == "[";
            depth += i32::from(["(", "[", "{"].contains(&token));
            depth -= i32::from([")", "]", "}"].contains(&token));
            at += 1;
            if depth == 0 && !attribute && (token == ";" || token == "}") {
                break;
            }
        }
    }
    kept
}

pub type Module = Vec<String>;

/// One crate's files as modules.
pub struct Crate {
    pub modules: BTreeMap<Module, File>,
}

pub struct File {
    pub path: String,
    tokens: Vec<String>,
    /// Names that `use` declarations import, with their paths; `*` for a glob.
    uses: Vec<(String, Vec<String>)>,
}

impl Crate {
    pub fn read(folder: &str) -> Self {
        let modules = sources(folder).into_iter().filter(|path| !path.ends_with("/main.rs"));
        let modules = modules.map(|path| {
            let inside = path.trim_start_matches(folder).trim_end_matches(".rs");
            let mut module: Module =
                inside.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect();
            if module.last().is_some_and(|name| name == "mod" || name == "lib") {
                module.pop();
            }
            let tokens = code(&path);
            let uses = uses(&tokens);
            (module, File { path, tokens, uses })
        });
        Self { modules: modules.collect() }
    }

    /// The module whose file defines the target of a path in `from`, through at most `depth`
    /// re-exports; `None` if another crate defines it.
    fn resolve(&self, from: &Module, path: &[String], depth: usize) -> Option<Module> {
        let mut at = from.clone();
        let mut names = path.iter().peekable();
        match names.peek()?.as_str() {
            "crate" => at = Module::new(),
            "self" => {}
            "super" => {
                at.pop()?;
            }
            first if self.modules.contains_key(&join(from, first)) => at.push(first.to_owned()),
            _ => return None,
        }
        names.next();
        for (index, name) in path.iter().enumerate().skip(1) {
            if name == "super" {
                at.pop()?;
            } else if self.modules.contains_key(&join(&at, name)) {
                at.push(name.clone());
            } else {
                let rest = &path[index + 1..];
                return Some(self.reexported(&at, name, rest, depth).unwrap_or(at));
            }
        }
        Some(at)
    }

    /// The module that defines a name which `at` only re-exports.
    fn reexported(&self, at: &Module, name: &str, rest: &[String], depth: usize) -> Option<Module> {
        let uses = &self.modules.get(at)?.uses;
        let depth = depth.checked_sub(1)?;
        for (used, path) in uses.iter().filter(|(used, _)| used == name || used == "*") {
            if used == name {
                return self.resolve(at, &[path, rest].concat(), depth);
            }
            let target = self.resolve(at, path, depth)?;
            let defines = |file: &File| {
                file.tokens
                    .windows(2)
                    .any(|pair| ITEMS.contains(&pair[0].as_str()) && pair[1] == name)
            };
            if self.modules.get(&target).is_some_and(defines) {
                return Some(target);
            }
        }
        None
    }

    /// For each module, the other modules that it names.
    pub fn graph(&self) -> BTreeMap<&Module, BTreeSet<Module>> {
        let known = |(module, file): (_, &File)| {
            let paths = file.uses.iter().map(|(_, path)| path.clone()).chain(paths(&file.tokens));
            let known = paths.filter_map(|path| self.resolve(module, &path, 8));
            (module, known.filter(|other| other != module).collect())
        };
        self.modules.iter().map(known).collect()
    }
}

const ITEMS: [&str; 8] = ["fn", "struct", "enum", "trait", "const", "static", "type", "union"];

fn join(module: &Module, name: &str) -> Module {
    let mut joined = module.clone();
    joined.push(name.to_owned());
    joined
}

/// The names and paths of all `use` declarations, with groups expanded.
fn uses(tokens: &[String]) -> Vec<(String, Vec<String>)> {
    let mut found = Vec::new();
    let begins = |at: &usize| tokens[*at] == "use" && (*at == 0 || tokens[at - 1] != "::");
    for start in (0..tokens.len()).filter(begins) {
        tree(tokens, start + 1, &[], &mut found);
    }
    found
}

/// Reads one tree of a `use` declaration, and returns the position after it.
fn tree(
    tokens: &[String],
    mut at: usize,
    prefix: &[String],
    found: &mut Vec<(String, Vec<String>)>,
) -> usize {
    let mut path = prefix.to_vec();
    while let Some(token) = tokens.get(at) {
        match token.as_str() {
            "::" => at += 1,
            "{" => {
                at += 1;
                while tokens.get(at).is_some_and(|token| token != "}") {
                    at = tree(tokens, at, &path, found);
                    at += usize::from(tokens.get(at).is_some_and(|token| token == ","));
                }
                return at + 1;
            }
            "as" => {
                found.push((tokens.get(at + 1).cloned().unwrap_or_default(), path));
                return at + 2;
            }
            "*" => {
                found.push(("*".to_owned(), path));
                return at + 1;
            }
            "," | ";" | "}" => break,
            name => {
                path.push(name.to_owned());
                at += 1;
            }
        }
    }
    if path.len() > 1 && path.last().is_some_and(|name| name == "self") {
        path.pop();
    }
    found.push((path.last().cloned().unwrap_or_default(), path));
    at
}

/// Paths in code that start with `crate`, `self` or `super`.
fn paths(tokens: &[String]) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    for start in 0..tokens.len() {
        let begins = ["crate", "self", "super"].contains(&tokens[start].as_str());
        if !begins || start > 0 && tokens[start - 1] == "::" {
            continue;
        }
        let mut path = vec![tokens[start].clone()];
        let mut at = start + 1;
        while tokens.get(at).is_some_and(|token| token == "::")
            && tokens.get(at + 1).is_some_and(|name| name.starts_with(char::is_alphabetic))
        {
            path.push(tokens[at + 1].clone());
            at += 2;
        }
        if path.len() > 1 {
            found.push(path);
        }
    }
    found
}

#[test]
fn tokenizer_skips_tests_comments_and_literals() {
    let text = r###"
        //! crate::comment
        #[cfg(test)]
        #[path = "x"]
        mod early { use crate::hidden; fn f() { "}" } }
        #[cfg(test)]
        use crate::hidden;
        /* crate::comment /* nested */ crate::comment */
        const QUOTE: (char, char, &'static str) = ('"', '\'', r#"crate::"text"#);
        use crate::{a::{self, B as C}, d::*};
        fn late() { super::e::F::<crate::g::H>::new() }
    "###;
    let tokens = without_tests(&tokens(text));
    let named: Vec<_> =
        uses(&tokens).into_iter().map(|(name, path)| (name, path.join("::"))).collect();
    let expected = [("a", "crate::a"), ("C", "crate::a::B"), ("*", "crate::d")];
    assert_eq!(named, expected.map(|(name, path)| (name.to_owned(), path.to_owned())));
    let paths: Vec<_> = paths(&tokens).iter().map(|path| path.join("::")).collect();
    assert_eq!(paths, ["super::e::F", "crate::g::H"]);
    assert!(!tokens.contains(&"hidden".to_owned()) && !tokens.contains(&"comment".to_owned()));
}

//! What a user is told: errors that end the loading, and warnings that do not.

use std::fmt;
use std::path::{Path, PathBuf};

/// A place in a file.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Place {
    /// The file.
    pub path: PathBuf,
    /// Line, from 1; 0 where none can be named.
    pub line: u32,
}

impl Place {
    /// A line of a file.
    pub fn new(path: impl Into<PathBuf>, line: u32) -> Self {
        Self { path: path.into(), line }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        if self.line > 0 { write!(f, ":{}", self.line) } else { Ok(()) }
    }
}

/// Something doubtful that was put right or left out.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Warning {
    /// Where.
    pub place: Place,
    /// What is doubtful, and what was done about it.
    pub message: String,
}

impl Warning {
    /// A warning about a line of a file.
    pub fn new(place: Place, message: impl Into<String>) -> Self {
        Self { place, message: message.into() }
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.message)
    }
}

/// Why a file cannot be had.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileProblem {
    /// Its name leads out of the scene's folder.
    Escapes,
    /// There is none.
    Missing,
    /// It is a folder, a device or a pipe.
    NotAFile,
    /// It is larger than the limit, bytes.
    TooLarge {
        /// Its size, bytes.
        bytes: u64,
        /// The limit, bytes.
        limit: u64,
    },
    /// The system refuses.
    Unreadable(std::io::ErrorKind),
}

impl fmt::Display for FileProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Escapes => {
                write!(f, "leads out of the scene's folder, which is not allowed; copy the file into it")
            }
            Self::Missing => write!(f, "does not exist; check the name"),
            Self::NotAFile => write!(f, "is not a regular file"),
            Self::TooLarge { bytes, limit } => {
                write!(f, "has {bytes} bytes, more than the limit of {limit}; split or reduce it")
            }
            Self::Unreadable(kind) => write!(f, "cannot be read: {kind}"),
        }
    }
}

/// Why a scene cannot be loaded. Every variant names the file and, with its text, the remedy.
#[derive(Clone, Debug, PartialEq)]
pub enum SceneError {
    /// The scene file itself, or a mesh, cannot be read.
    File {
        /// The file.
        path: PathBuf,
        /// What is the matter with it.
        problem: FileProblem,
        /// Who asked for it; `None` for the file that was given.
        asked_by: Option<Place>,
    },
    /// Neither a mesh nor a sidecar by its ending.
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// A sidecar that is not TOML.
    Syntax {
        /// Where.
        place: Place,
        /// The parser's message.
        message: String,
    },
    /// A key that no sidecar has.
    UnknownKey {
        /// Where.
        place: Place,
        /// The key.
        key: String,
        /// The table that it is in, as written in a header.
        table: String,
        /// The known key that is most like it.
        nearest: Option<String>,
    },
    /// A value of a wrong type.
    WrongType {
        /// Where.
        place: Place,
        /// The key.
        key: String,
        /// What the key takes.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A key that must be there is absent.
    MissingKey {
        /// Where the table begins.
        place: Place,
        /// The key.
        key: String,
        /// The table that lacks it, as written in a header.
        table: String,
    },
    /// A value that has no meaning.
    Invalid {
        /// Where.
        place: Place,
        /// What is wrong and what to write instead.
        message: String,
    },
    /// A binary file that is none.
    Container {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        message: String,
    },
    /// A glTF document that says what cannot be.
    Document {
        /// Where.
        place: Place,
        /// The same as a JSON pointer, such as `/accessors/3/count`; empty where the text itself is broken.
        pointer: String,
        /// What is wrong and what to do.
        message: String,
    },
    /// A glTF document that cannot be shown without extensions that this build does not know.
    RequiredExtension {
        /// Where.
        place: Place,
        /// All of them.
        names: Vec<String>,
        /// What to do.
        remedy: String,
    },
    /// Nothing to draw.
    NoGeometry {
        /// The scene.
        path: PathBuf,
        /// Why, and what to do.
        message: String,
    },
}

impl SceneError {
    pub(super) fn invalid(place: Place, message: impl Into<String>) -> Self {
        Self::Invalid { place, message: message.into() }
    }

    /// The file that the error is about.
    pub fn path(&self) -> &Path {
        match self {
            Self::File { path, .. }
            | Self::UnknownFormat { path }
            | Self::NoGeometry { path, .. }
            | Self::Container { path, .. } => path,
            Self::Syntax { place, .. }
            | Self::UnknownKey { place, .. }
            | Self::WrongType { place, .. }
            | Self::MissingKey { place, .. }
            | Self::Invalid { place, .. }
            | Self::Document { place, .. }
            | Self::RequiredExtension { place, .. } => &place.path,
        }
    }
}

impl fmt::Display for SceneError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { path, problem, asked_by } => {
                if let Some(place) = asked_by {
                    write!(f, "{place} asks for ")?;
                }
                write!(f, "{}, which {problem}", path.display())
            }
            Self::UnknownFormat { path } => {
                write!(
                    f,
                    "{}: not a scene; give an .obj, .gltf or .glb file or its sidecar .toml",
                    path.display()
                )
            }
            Self::Syntax { place, message } => write!(f, "{place}: not valid TOML: {message}"),
            Self::UnknownKey { place, key, table, nearest } => {
                write!(f, "{place}: unknown key `{key}` in {table}")?;
                match nearest {
                    Some(n) => write!(f, "; did you mean `{n}`?"),
                    None => write!(f, "; remove it"),
                }
            }
            Self::WrongType { place, key, expected, found } => {
                write!(f, "{place}: `{key}` must be {expected}, but is {found}")
            }
            Self::MissingKey { place, key, table } => {
                write!(f, "{place}: {table} has no `{key}`; add it")
            }
            Self::Invalid { place, message } => write!(f, "{place}: {message}"),
            Self::Container { path, message } => {
                write!(f, "{}: not a readable .glb file: {message}", path.display())
            }
            Self::Document { place, pointer, message } if pointer.is_empty() => {
                write!(f, "{place}: {message}")
            }
            Self::Document { place, pointer, message } => write!(f, "{place}: {pointer}: {message}"),
            Self::RequiredExtension { place, names, remedy } => {
                let s = if names.len() == 1 { "" } else { "s" };
                let names = names.join(", ");
                write!(
                    f,
                    "{place}: requires the extension{s} {names}, which this build does not know; {remedy}"
                )
            }
            Self::NoGeometry { path, message } => write!(f, "{}: {message}", path.display()),
        }
    }
}

impl std::error::Error for SceneError {}

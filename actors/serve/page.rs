//! The page: files that are part of the program, as they are served.

/// What a browser may do with the page: run our modules and talk to us, nothing else.
pub const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
     connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

/// The same of a picture by itself, around which browsers put a page with a style of their own.
pub const PICTURE_POLICY: &str =
    "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; frame-ancestors 'none'";

/// Most bytes of all files together.
#[cfg(test)]
const BYTES_MAX: usize = 48 << 10;

/// A file of the page.
#[derive(Clone, Copy, Debug)]
pub struct File {
    /// Its media type.
    pub kind: &'static str,
    /// What is in it.
    pub bytes: &'static str,
}

const SCRIPT: &str = "text/javascript; charset=utf-8";

/// All files, by path.
const FILES: [(&str, File); 11] = [
    ("/", File { kind: "text/html; charset=utf-8", bytes: include_str!("page/index.html") }),
    ("/style.css", File { kind: "text/css; charset=utf-8", bytes: include_str!("page/style.css") }),
    ("/icon.svg", File { kind: "image/svg+xml", bytes: include_str!("page/icon.svg") }),
    ("/main.js", File { kind: SCRIPT, bytes: include_str!("page/main.js") }),
    ("/connection.js", File { kind: SCRIPT, bytes: include_str!("page/connection.js") }),
    ("/picture.js", File { kind: SCRIPT, bytes: include_str!("page/picture.js") }),
    ("/input.js", File { kind: SCRIPT, bytes: include_str!("page/input.js") }),
    ("/panel.js", File { kind: SCRIPT, bytes: include_str!("page/panel.js") }),
    ("/scene.js", File { kind: SCRIPT, bytes: include_str!("page/scene.js") }),
    ("/timeline.js", File { kind: SCRIPT, bytes: include_str!("page/timeline.js") }),
    ("/insight.js", File { kind: SCRIPT, bytes: include_str!("page/insight.js") }),
];

/// The file at a path.
pub fn file(path: &str) -> Option<File> {
    FILES.into_iter().find(|(name, _)| *name == path).map(|(_, file)| file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_small_and_asks_nobody_else() {
        let size: usize = FILES.iter().map(|(_, file)| file.bytes.len()).sum();
        assert!(size <= BYTES_MAX, "{size} bytes");
        for (name, file) in FILES {
            // (The namespace of SVG is a name, not an address.)
            let text = file.bytes.replace("http://www.w3.org/2000/svg", "");
            assert!(!text.contains("http://") && !text.contains("https://"), "{name}");
            assert!(!text.contains("style=\"") && !text.contains("onclick"), "{name}: the policy forbids it");
        }
    }

    #[test]
    fn what_the_page_names_is_there() {
        let (_, index) = FILES[0];
        let named = |text: &'static str, before: &'static str| {
            text.split(before).skip(1).filter_map(|rest| rest.split('"').next())
        };
        for path in named(index.bytes, "src=\"").chain(named(index.bytes, "href=\"")) {
            assert!(path.starts_with('#') || file(&format!("/{path}")).is_some(), "index.html names {path}");
        }
        for (name, File { bytes, .. }) in FILES {
            for path in named(bytes, "from \"./") {
                assert!(file(&format!("/{path}")).is_some(), "{name} names {path}");
            }
        }
    }
}

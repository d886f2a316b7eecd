//! The statements of MTL files.
//!
//! Read here and not by `tobj`, which panics at a colour of one number (`Kd 0.5`), gives up the
//! whole file at one bad number, and knows neither `Tr`, `Tf` and `Pr` nor the options of maps.

use std::path::Path;

use glam::Vec3;

use super::error::{Place, Warning};

/// A picture with its options.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MapStatement {
    /// As written.
    pub file: String,
    /// Line.
    pub line: u32,
    /// Scale (two numbers) and offset (two numbers) of the coordinates.
    pub scale_offset: [f32; 4],
    /// Whether coordinates are clamped.
    pub clamp: bool,
    /// Factor of a height field.
    pub bump: f32,
}

/// A material as its MTL file says it. `None` is what it does not say.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct MtlMaterial {
    pub name: String,
    pub line: u32,
    pub illum: Option<u32>,
    pub kd: Option<Vec3>,
    pub ks: Option<Vec3>,
    pub ke: Option<Vec3>,
    pub tf: Option<Vec3>,
    pub ns: Option<f32>,
    pub ni: Option<f32>,
    pub d: Option<f32>,
    pub tr: Option<f32>,
    pub pr: Option<f32>,
    pub pm: Option<f32>,
    pub aniso: Option<f32>,
    pub map_kd: Option<MapStatement>,
    pub map_ks: Option<MapStatement>,
    pub map_ke: Option<MapStatement>,
    pub map_d: Option<MapStatement>,
    pub bump: Option<MapStatement>,
    pub norm: Option<MapStatement>,
}

/// Numbers beyond this are taken for a slip.
const NUMBER_MAX: f32 = 1e9;

/// Reads the materials of an MTL file. Bad lines are left out with a warning; it cannot fail.
pub(super) fn parse(bytes: &[u8], path: &Path, warnings: &mut Vec<Warning>) -> Vec<MtlMaterial> {
    let text = String::from_utf8_lossy(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes));
    let mut materials: Vec<MtlMaterial> = Vec::new();
    let mut unknown: Vec<(String, u32)> = Vec::new();
    let mut bad: Vec<(String, u32)> = Vec::new();
    for (i, raw) in text.split('\n').enumerate() {
        let line = i as u32 + 1;
        let statement = raw.trim_matches(|c: char| c.is_whitespace() || c == '\0');
        let (key, rest) = statement.split_once(char::is_whitespace).unwrap_or((statement, ""));
        let rest = rest.trim();
        if key.is_empty() || key.starts_with('#') {
            continue;
        }
        if key == "newmtl" {
            materials.push(MtlMaterial { name: rest.to_owned(), line, ..Default::default() });
            continue;
        }
        if key == "mtllib" {
            bad.push(("an MTL file cannot include another; left out".to_owned(), line));
            continue;
        }
        let Some(material) = materials.last_mut() else {
            bad.push((format!("`{key}` before the first `newmtl`; left out"), line));
            continue;
        };
        match material.set(key, rest, line) {
            Ok(true) => {}
            Ok(false) => unknown.push((key.to_owned(), line)),
            Err(message) => bad.push((format!("{message}; left out"), line)),
        }
    }
    let rest = bad.len().saturating_sub(8);
    for (message, line) in bad.into_iter().take(8) {
        warnings.push(Warning::new(Place::new(path, line), message));
    }
    if rest > 0 {
        warnings.push(Warning::new(Place::new(path, 0), format!("{rest} more lines left out")));
    }
    if let Some((key, line)) = unknown.first() {
        let more =
            if unknown.len() > 1 { format!(", and {} more lines", unknown.len() - 1) } else { String::new() };
        warnings.push(Warning::new(Place::new(path, *line), format!("`{key}` is not used{more}")));
    }
    materials
}

/// A finite number of sensible size.
fn number(word: Option<&str>) -> Result<f32, String> {
    let word = word.ok_or("a number is missing")?;
    let v: f32 = word.parse().map_err(|_| format!("`{word}` is no number"))?;
    if v.is_finite() && v.abs() <= NUMBER_MAX { Ok(v) } else { Err(format!("`{word}` is out of range")) }
}

/// One number for all bands, or three.
fn color(rest: &str) -> Result<Vec3, String> {
    let mut words = rest.split_whitespace().take_while(|w| !w.starts_with('#'));
    match words.next() {
        Some("spectral") => Err("spectral colours are not read".to_owned()),
        Some("xyz") => {
            let xyz = [number(words.next())?, number(words.next())?, number(words.next())?];
            Ok(rgb_from_xyz(Vec3::from(xyz)).max(Vec3::ZERO))
        }
        first => {
            let r = number(first)?;
            let c = match words.next() {
                None => Vec3::splat(r),
                second => Vec3::new(r, number(second)?, number(words.next())?),
            };
            if c.min_element() < 0.0 { Err("a colour is negative".to_owned()) } else { Ok(c) }
        }
    }
}

/// CIE XYZ (D65) to linear Rec. 709 (IEC 61966-2-1).
fn rgb_from_xyz(c: Vec3) -> Vec3 {
    Vec3::new(
        c.dot(Vec3::new(3.240_625, -1.537_208, -0.498_629)),
        c.dot(Vec3::new(-0.968_931, 1.875_756, 0.041_518)),
        c.dot(Vec3::new(0.055_710, -0.204_021, 1.056_996)),
    )
}

/// The rest of a line without its first word.
fn after_word(text: &str) -> (&str, &str) {
    let text = text.trim_start();
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

/// `-option values … file name with blanks`.
fn map(rest: &str, line: u32) -> Result<MapStatement, String> {
    let mut m = MapStatement {
        file: String::new(),
        line,
        scale_offset: [1.0, 1.0, 0.0, 0.0],
        clamp: false,
        bump: 1.0,
    };
    let mut rest = rest.trim();
    // One to three numbers, of which two count.
    fn pair<'a>(rest: &mut &'a str, absent: f32) -> [f32; 2] {
        let mut values = [absent, absent];
        let mut ignored = 0.0;
        for value in values.iter_mut().chain(std::iter::once(&mut ignored)) {
            let (word, after): (&'a str, &'a str) = after_word(rest);
            let Ok(v) = number(Some(word)) else { break };
            *value = v;
            *rest = after;
        }
        values
    }
    while rest.starts_with('-') {
        let (option, after) = after_word(rest);
        rest = after;
        match option {
            "-s" => {
                let [u, v] = pair(&mut rest, 1.0);
                m.scale_offset[0] = u;
                m.scale_offset[1] = v;
            }
            "-o" => {
                let [u, v] = pair(&mut rest, 0.0);
                m.scale_offset[2] = u;
                m.scale_offset[3] = v;
            }
            "-t" | "-mm" => {
                pair(&mut rest, 0.0);
            }
            "-bm" => {
                let (word, after) = after_word(rest);
                m.bump = number(Some(word))?;
                rest = after;
            }
            "-clamp" => {
                let (word, after) = after_word(rest);
                m.clamp = word.eq_ignore_ascii_case("on");
                rest = after;
            }
            "-blendu" | "-blendv" | "-cc" | "-imfchan" | "-type" | "-texres" | "-boost" | "-colorspace" => {
                rest = after_word(rest).1;
            }
            // A file name may begin with a dash.
            _ => {
                m.file = format!("{option} {rest}").trim().to_owned();
                return Ok(m);
            }
        }
    }
    if rest.is_empty() {
        return Err("a map without a file".to_owned());
    }
    m.file = rest.trim_matches('"').to_owned();
    Ok(m)
}

impl MtlMaterial {
    /// Takes a statement; `false` if it is not one that is used.
    fn set(&mut self, key: &str, rest: &str, line: u32) -> Result<bool, String> {
        let named = |e: String| format!("`{key}`: {e}");
        let one = || number(rest.split_whitespace().next()).map_err(named);
        let three = || color(rest).map_err(named);
        let picture = || map(rest, line).map_err(named);
        match key.to_ascii_lowercase().as_str() {
            "kd" => self.kd = Some(three()?),
            "ks" => self.ks = Some(three()?),
            "ke" => self.ke = Some(three()?),
            "tf" => self.tf = Some(three()?),
            "ns" => self.ns = Some(one()?),
            "ni" => self.ni = Some(one()?),
            "d" => {
                // `d -halo 0.5` fades at the rim; the number is what counts.
                let rest = rest.strip_prefix("-halo").unwrap_or(rest);
                self.d = Some(number(rest.split_whitespace().next()).map_err(named)?);
            }
            "tr" => self.tr = Some(one()?),
            "pr" => self.pr = Some(one()?),
            "pm" => self.pm = Some(one()?),
            "aniso" => self.aniso = Some(one()?),
            "illum" => self.illum = Some(one()?.clamp(0.0, 10.0) as u32),
            "map_kd" => self.map_kd = Some(picture()?),
            "map_ks" => self.map_ks = Some(picture()?),
            "map_ke" => self.map_ke = Some(picture()?),
            "map_d" => self.map_d = Some(picture()?),
            "bump" | "map_bump" => self.bump = Some(picture()?),
            "norm" | "map_kn" => self.norm = Some(picture()?),
            // Ambient light is what the illumination map computes.
            "ka" | "map_ka" | "sharpness" => {}
            _ => return Ok(false),
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> (Vec<MtlMaterial>, Vec<String>) {
        let mut warnings = Vec::new();
        let m = parse(text.as_bytes(), Path::new("m.mtl"), &mut warnings);
        (m, warnings.iter().map(Warning::to_string).collect())
    }

    #[test]
    fn names_may_have_blanks_and_lines_may_be_indented() {
        let (m, w) =
            read("\t newmtl  a b  \r\n   Kd .5\r\n\tNs 10.0 # x\nKs 0 0 0.25 # y\nillum 2   \nnewmtl\n");
        assert_eq!((m[0].name.as_str(), m[1].name.as_str()), ("a b", ""));
        assert_eq!(m[0].kd, Some(Vec3::splat(0.5)));
        assert_eq!(m[0].ns, Some(10.0));
        assert_eq!(m[0].ks, Some(Vec3::new(0.0, 0.0, 0.25)));
        assert_eq!(m[0].illum, Some(2));
        assert!(w.is_empty(), "{w:?}");
    }

    #[test]
    fn bad_statements_are_left_out_with_their_line() {
        let (m, w) = read(
            "Kd 1 1 1\nnewmtl m\nKd 1 x 1\nKd 1 2\nNs nan\nd 1e30\nKs -1 0 0\nmap_Kd\ncrazy 1\nPs 1\nmtllib m.mtl\n",
        );
        assert_eq!(m[0], MtlMaterial { name: "m".into(), line: 2, ..Default::default() });
        assert_eq!(w.len(), 9, "{w:#?}");
        assert_eq!(w[0], "m.mtl:1: `Kd` before the first `newmtl`; left out");
        assert_eq!(w[1], "m.mtl:3: `Kd`: `x` is no number; left out");
        assert_eq!(w[8], "m.mtl:9: `crazy` is not used, and 1 more lines");
    }

    #[test]
    fn options_of_maps() {
        let (m, w) = read(
            "newmtl m\nmap_Kd -s 2 3 1 -o .5 -clamp on my wood.png\nbump -bm 0.3 -imfchan l a.png\nmap_d -odd.png\n\
             map_Ke -mm 0 1 -t 1 1 1 -blendu on textures\\e.png\n",
        );
        let kd = m[0].map_kd.as_ref().unwrap();
        assert_eq!(kd.file, "my wood.png");
        assert_eq!(kd.scale_offset, [2.0, 3.0, 0.5, 0.0]);
        assert!(kd.clamp);
        let bump = m[0].bump.as_ref().unwrap();
        assert_eq!((bump.file.as_str(), bump.bump), ("a.png", 0.3));
        assert_eq!(m[0].map_d.as_ref().unwrap().file, "-odd.png");
        assert_eq!(m[0].map_ke.as_ref().unwrap().file, "textures\\e.png");
        assert!(w.is_empty(), "{w:?}");
    }

    #[test]
    fn white_in_xyz_is_white() {
        let white = rgb_from_xyz(Vec3::new(0.95047, 1.0, 1.08883));
        assert!((white - Vec3::ONE).abs().max_element() < 1e-3, "{white}");
    }

    proptest::proptest! {
        #[test]
        fn no_text_can_break_it(text in "((newmtl|Kd|map_Kd|d|bump|illum|Ns)[ a0-9.\\-seobm]{0,20}[\r\n]){0,30}") {
            read(&text);
        }
    }
}

//! What becomes of extensions: those that are read, those that change nothing that is shown, and the rest.

use std::collections::BTreeSet;

use super::Oddities;
use super::document::Document;
use crate::load::error::{Place, SceneError};
use foveal::scene::ExtensionUse;

/// Extensions that are known, in order, and what becomes of them.
const KNOWN: [(&str, &str); 31] = [
    ("EXT_lights_image_based", "the finest pictures are the environment; light is computed from them"),
    ("EXT_mesh_gpu_instancing", "shown"),
    ("EXT_meshopt_compression", "decoded"),
    ("EXT_texture_webp", "shown"),
    (
        "KHR_animation_pointer",
        "transforms, weights, visibility, lights, colours and fields of view at the chosen time",
    ),
    ("KHR_lights_punctual", "shown"),
    ("KHR_materials_anisotropy", "shown"),
    ("KHR_materials_clearcoat", "shown"),
    ("KHR_materials_diffuse_transmission", "shown"),
    ("KHR_materials_dispersion", "shown in bodies of glass"),
    ("KHR_materials_emissive_strength", "shown"),
    ("KHR_materials_ior", "shown"),
    ("KHR_materials_iridescence", "shown"),
    ("KHR_materials_pbrSpecularGlossiness", "shown"),
    ("KHR_materials_sheen", "shown"),
    ("KHR_materials_specular", "shown"),
    ("KHR_materials_transmission", "shown"),
    ("KHR_materials_unlit", "shown"),
    ("KHR_materials_variants", "the chosen one is shown"),
    ("KHR_materials_volume", "shown; rays find their own way through, whatever thickness is said"),
    ("KHR_mesh_quantization", "shown"),
    ("KHR_meshopt_compression", "decoded"),
    ("KHR_node_hoverability", NOTHING),
    ("KHR_node_selectability", NOTHING),
    ("KHR_node_visibility", "what is invisible is left out"),
    ("KHR_texture_transform", "shown"),
    ("KHR_xmp", NOTHING),
    ("KHR_xmp_json_ld", NOTHING),
    ("MSFT_lod", "the finest level is shown"),
    // Of builds without them known only where they are not required.
    (
        DRACO,
        if cfg!(feature = "draco") {
            "decoded"
        } else {
            "not decoded; the uncompressed mesh beside it is shown"
        },
    ),
    (
        BASISU,
        if cfg!(feature = "basisu") {
            "decoded"
        } else {
            "not decoded; the other picture beside it is shown"
        },
    ),
];

const DRACO: &str = "KHR_draco_mesh_compression";
const BASISU: &str = "KHR_texture_basisu";

const NOTHING: &str = "nothing to show";

/// Whether a file may require it.
fn known(name: &str) -> bool {
    let is_built = (name != DRACO || cfg!(feature = "draco")) && (name != BASISU || cfg!(feature = "basisu"));
    is_built && listed(name)
}

/// Whether what becomes of it is known, required or not.
fn listed(name: &str) -> bool {
    KNOWN.iter().any(|(n, _)| *n == name)
}

/// Whether what an extension adds is a detail of what is there without it.
fn is_detail(name: &str) -> bool {
    ["KHR_materials_", "KHR_xmp", "KHR_node_", "KHR_interactivity"]
        .iter()
        .any(|start| name.starts_with(start))
}

/// How to do without an extension.
fn remedy(names: &[String]) -> String {
    let compressed = |n: &String| n.contains("draco") || n.contains("basisu") || n.contains("compression");
    if names.iter().all(|n| is_detail(n)) {
        return format!("--ignore-extension {} loads it without", names.join(" --ignore-extension "));
    }
    if names.iter().any(compressed) {
        return "export it again without compression".to_owned();
    }
    "export it again without, or name them after --ignore-extension".to_owned()
}

/// How often a document has an object of this name.
fn objects(json: &[u8], name: &str) -> usize {
    let key = format!("\"{name}\"");
    memchr::memmem::find_iter(json, key.as_bytes())
        .filter(|at| json[at + key.len()..].iter().find(|b| !b.is_ascii_whitespace()) == Some(&b':'))
        .count()
}

/// What becomes of each extension that a document names or has objects of, in the order of their names.
fn used(document: &Document, json: &[u8], ignored: &[String]) -> Vec<ExtensionUse> {
    let named = document.extensions_used.iter().chain(document.extensions_required.iter());
    let mut names: BTreeSet<String> = named.take(NAMES_MAX).map(|n| super::buffers::shortened(n)).collect();
    names.extend(KNOWN.iter().filter(|(n, _)| objects(json, n) > 0).map(|(n, _)| (*n).to_owned()));
    let of = |name: String| {
        let known = KNOWN.iter().find(|(n, _)| *n == name);
        let became = match known {
            _ if ignored.contains(&name) => "ignored, as was asked for",
            Some((_, became)) => became,
            None => "not known to this build; shown without",
        };
        ExtensionUse { times: objects(json, &name), became: became.to_owned(), name }
    };
    names.into_iter().map(of).collect()
}

/// Names of extensions that are listed.
const NAMES_MAX: usize = 256;

/// Refuses a document that requires what this build does not know, and says what of the rest is not shown.
/// `json` is the document's text.
pub(super) fn check(
    document: &Document,
    json: &[u8],
    ignored: &[String],
    place: &Place,
    odd: &mut Oddities,
) -> Result<Vec<ExtensionUse>, SceneError> {
    // What is required by mistake, since nothing says that it is used and nothing does, is not missed.
    let unused =
        |name: &String| !document.extensions_used.iter().any(|u| u == name) && objects(json, name) == 0;
    let ignores = |name: &String| ignored.iter().any(|i| i == name) || unused(name);
    let required = || document.extensions_required.iter().filter(|n| !known(n));
    let names: Vec<String> =
        required().filter(|n| !ignores(n)).map(|n| super::buffers::shortened(n)).collect();
    if !names.is_empty() {
        return Err(SceneError::RequiredExtension { place: place.clone(), remedy: remedy(&names), names });
    }
    let mut unknown: Vec<String> = Vec::new();
    for name in document.extensions_used.iter().chain(required()).filter(|n| !listed(n)) {
        let name = super::buffers::shortened(name);
        if !unknown.contains(&name) && unknown.len() < 32 {
            unknown.push(name);
        }
    }
    if !unknown.is_empty() {
        odd.count(&unknown.join(", "), "not known to this build; shown without");
    }
    let used = used(document, json, ignored);
    for extension in &used {
        if !document
            .extensions_used
            .iter()
            .chain(document.extensions_required.iter())
            .any(|n| *n == extension.name)
        {
            odd.count(&extension.name, "not declared by the file; shown all the same");
        }
    }
    Ok(used)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(document: &str, ignored: &[&str]) -> Result<bool, String> {
        let text = format!("{{\"asset\": {{\"version\": \"2.0\"}}, {document}}}");
        let document: Document = serde_json::from_str(&text).unwrap();
        let ignored: Vec<String> = ignored.iter().map(|s| (*s).to_owned()).collect();
        let mut odd = Oddities::default();
        check(&document, text.as_bytes(), &ignored, &Place::new("a.glb", 0), &mut odd)
            .map_err(|e| e.to_string())?;
        Ok(!odd.is_empty())
    }

    #[test]
    fn one_error_names_all_that_is_required() {
        let two = r#""extensionsRequired": ["KHR_materials_lint", "KHR_texture_transform", "KHR_materials_wax"],
            "extensionsUsed": ["KHR_materials_lint"], "extras": {"KHR_materials_wax" : {}}"#;
        assert_eq!(
            checked(two, &["KHR_materials_fur"]),
            Err("a.glb: requires the extensions KHR_materials_lint, KHR_materials_wax, which this build does not know; \
                 --ignore-extension KHR_materials_lint --ignore-extension KHR_materials_wax loads it without"
                .to_owned())
        );
        assert_eq!(checked(two, &["KHR_materials_lint", "KHR_materials_wax"]), Ok(true));
        let draco = r#""extensionsRequired": ["KHR_draco_mesh_compression"],
            "extensionsUsed": ["KHR_draco_mesh_compression"]"#;
        assert!(checked(draco, &[]).unwrap_err().contains("without compression"));
        // Nothing uses it.
        assert_eq!(checked(r#""extensionsRequired": ["KHR_materials_fur"]"#, &[]), Ok(true));
        assert_eq!(checked(r#""extensionsUsed": ["KHR_lights_punctual", "KHR_xmp"]"#, &[]), Ok(false));
        assert_eq!(checked(r#""extensionsUsed": ["ADOBE_magic"]"#, &[]), Ok(true));
    }

    #[test]
    fn each_extension_is_listed_with_what_became_of_it() {
        let text = r#"{"asset": {"version": "2.0"}, "extensionsUsed": ["KHR_materials_wax", "KHR_xmp", "KHR_materials_ior"],
            "materials": [{"extensions": {"KHR_materials_ior": {}}}, {"extensions": {"KHR_materials_ior" : {"ior": 1.3},
            "KHR_materials_sheen": {}, "KHR_materials_wax": {}}}]}"#;
        let document: Document = serde_json::from_str(text).unwrap();
        let mut odd = Oddities::default();
        let used =
            check(&document, text.as_bytes(), &["KHR_materials_wax".into()], &Place::new("a", 0), &mut odd);
        let used: Vec<_> = used.unwrap().into_iter().map(|u| (u.name, u.times, u.became)).collect();
        let expected = [
            ("KHR_materials_ior", 2, "shown"),
            ("KHR_materials_sheen", 1, "shown"),
            ("KHR_materials_wax", 1, "ignored, as was asked for"),
            ("KHR_xmp", 0, NOTHING),
        ];
        assert_eq!(used, expected.map(|(n, t, b)| (n.to_owned(), t, b.to_owned())));
        // The sheen was not declared, and wax is not known.
        assert!(odd.0.keys().any(|(what, done)| what.contains("sheen") && done.contains("not declared")));
    }
}

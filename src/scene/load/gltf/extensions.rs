//! What becomes of extensions: those that are read, those that change nothing that is shown, and the rest.

use super::Oddities;
use super::document::Document;
use crate::scene::load::error::{Place, SceneError};

/// Extensions whose effect is shown, or which say by a line of their own what of it is not.
const READ: [&str; 18] = [
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_transform",
];

/// Known, and nothing to show.
const WITHOUT_EFFECT: [&str; 6] = [
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_node_visibility",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_lod",
];

fn known(name: &str) -> bool {
    READ.contains(&name) || WITHOUT_EFFECT.contains(&name)
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

/// Whether a document has an object of this name anywhere.
fn has_object(json: &[u8], name: &str) -> bool {
    let key = format!("\"{name}\"");
    memchr::memmem::find_iter(json, key.as_bytes())
        .any(|at| json[at + key.len()..].iter().find(|b| !b.is_ascii_whitespace()) == Some(&b':'))
}

/// Refuses a document that requires what this build does not know, and says what of the rest is not shown.
/// `json` is the document's text.
pub(super) fn check(
    document: &Document,
    json: &[u8],
    ignored: &[String],
    place: &Place,
    odd: &mut Oddities,
) -> Result<(), SceneError> {
    // What is required by mistake, since nothing says that it is used and nothing does, is not missed.
    let unused =
        |name: &String| !document.extensions_used.iter().any(|u| u == name) && !has_object(json, name);
    let ignores = |name: &String| ignored.iter().any(|i| i == name) || unused(name);
    let required = || document.extensions_required.iter().filter(|n| !known(n));
    let names: Vec<String> =
        required().filter(|n| !ignores(n)).map(|n| super::buffers::shortened(n)).collect();
    if !names.is_empty() {
        return Err(SceneError::RequiredExtension { place: place.clone(), remedy: remedy(&names), names });
    }
    let mut unknown: Vec<String> = Vec::new();
    for name in document.extensions_used.iter().chain(required()).filter(|n| !known(n)) {
        let name = super::buffers::shortened(name);
        if !unknown.contains(&name) && unknown.len() < 32 {
            unknown.push(name);
        }
    }
    if !unknown.is_empty() {
        odd.count(&unknown.join(", "), "not known to this build; shown without");
    }
    Ok(())
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
}

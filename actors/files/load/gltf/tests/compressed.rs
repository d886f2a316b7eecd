//! Files whose meshes or pictures are compressed by what is built only where it is asked for.

use super::*;

#[cfg(feature = "basisu")]
#[test]
fn a_picture_of_basis_universal_is_the_base_colour() {
    use base64::Engine;
    let bytes = crate::load::ktx2::tests::file(1, &[[255, 0, 0, 255], [0, 0, 255, 255]]);
    let image = base64::engine::general_purpose::STANDARD.encode(bytes);
    let extension = r#""KHR_texture_basisu""#;
    let loaded = with_materials(
        "basisu",
        &format!(
            r#"[{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0}}, "metallicFactor": 0}}}}],
            "textures": [{{"extensions": {{{extension}: {{"source": 0}}}}}}],
            "images": [{{"uri": "data:image/ktx2;base64,{image}"}}],
            "extensionsUsed": [{extension}], "extensionsRequired": [{extension}]"#
        ),
    );
    assert!(!says(&loaded, "texture"), "{:?}", loaded.warnings);
    let texture = &loaded.scene.textures[0];
    assert_eq!(texture.size(0), [4, 8]);
    assert_eq!((texture.texel(0, 1, 1)[..3].to_vec(), texture.texel(0, 1, 6)[2]), (vec![1.0, 0.0, 0.0], 1.0));
}

/// A sheet of eight triangles, higher by one half in its middle, as an encoder for Draco wrote it.
#[cfg(feature = "draco")]
const SHEET: &str = concat!(
    "445241434f02020101000002090801080200ff0111ff0288400301020503ad2a07551503a07a81010101040b014001000101",
    "01040b01400100010101050f0140010001010101014001000002ff0000000000010009030000020103090200010201010101",
    "0380104928fffffffffffffffffffffffffffffff7dd0b6102fffffffffffffffffffffffffffffff77d0907538daac0f65e",
    "a700000000ff070000000000000000000000000000000000400b01010101028008c931ffffffffffffffffffffffffffffff",
    "f7390e04d2dd6d8c00000000ff03000000000000000000000000803f0a",
);

#[cfg(feature = "draco")]
fn sheet() -> Vec<u8> {
    (0..SHEET.len() / 2).map(|i| u8::from_str_radix(&SHEET[2 * i..2 * i + 2], 16).unwrap()).collect()
}

/// A file of that mesh, as these bytes have it, with so many vertices and corners.
#[cfg(feature = "draco")]
fn packed(bytes: &[u8], vertices: u32, corners: u32) -> String {
    let mut maker = Maker::default();
    let view = maker.view(bytes);
    maker.accessors = vec![
        format!(r#"{{"componentType": 5126, "count": {vertices}, "type": "VEC3"}}"#),
        format!(r#"{{"componentType": 5126, "count": {vertices}, "type": "VEC2"}}"#),
        format!(r#"{{"componentType": 5123, "count": {corners}, "type": "SCALAR"}}"#),
    ];
    maker.text(&format!(
        r#""meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "TEXCOORD_0": 1}}, "indices": 2,
            "extensions": {{"KHR_draco_mesh_compression":
                {{"bufferView": {view}, "attributes": {{"POSITION": 0, "TEXCOORD_0": 1}}}}}}}}]}}],
        "nodes": [{{"mesh": 0}}], "extensionsUsed": ["KHR_draco_mesh_compression"],
        "extensionsRequired": ["KHR_draco_mesh_compression"]"#
    ))
}

#[cfg(feature = "draco")]
#[test]
fn a_mesh_of_draco_is_the_one_that_was_compressed() {
    let place = TempFolder::new("draco");
    let scene = loaded(&place, packed(&sheet(), 11, 24)).scene;
    assert_eq!(scene.mesh.triangles.len(), 8);
    assert!((area(&scene) - 4.0).abs() < 0.01, "{}", area(&scene));
    for (p, uv) in scene.mesh.positions.iter().zip(&scene.mesh.uvs) {
        // Numbers of eleven bits.
        let in_the_middle = (p.truncate() - Vec2::ONE).abs().max_element() < 0.1;
        let height = if in_the_middle { 0.5 } else { 0.0 };
        assert!((p.z - height).abs() < 2e-3, "{p}");
        assert!((*uv - Vec2::new(0.5 * p.x, 1.0 - 0.5 * p.y)).abs().max_element() < 2e-3, "{p} {uv}");
    }
    assert_eq!(scene.mesh.positions.iter().filter(|p| p.z > 0.4).count(), 1);
}

#[cfg(feature = "draco")]
#[test]
fn a_broken_mesh_of_draco_is_an_error_that_says_what_to_do() {
    let place = TempFolder::new("draco-broken");
    let refused = |bytes: &[u8], vertices, corners| {
        let why = load(&place.write("a.gltf", packed(bytes, vertices, corners))).err()?.to_string();
        assert!(why.contains("without Draco compression"), "{why}");
        Some(why)
    };
    let whole = sheet();
    // More than is declared is refused before it is decoded, fewer after.
    assert!(refused(&whole, 8, 24).unwrap().contains("9 points"));
    assert!(refused(&whole, 11, 21).unwrap().contains("8 triangles"));
    assert!(refused(&whole, 12, 24).is_some());
    for length in (3..whole.len()).step_by(3) {
        refused(&whole[..length], 11, 24);
    }
    assert!(refused(&whole[..40], 11, 24).is_some());
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x55;
        refused(&bytes, 11, 24);
    }
}

//! What is chosen by name, and files that must not be believed.

use super::*;

#[test]
fn variants_and_required_extensions_are_chosen_by_name() {
    let place = TempFolder::new("gltf-variants");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker).replace(
        r#""material": 0"#,
        r#""material": 0, "extensions": {"KHR_materials_variants": {"mappings": [{"material": 1, "variants": [1]}]}}"#,
    );
    let rest = format!(
        r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{"name": "wood"}}, {{"name": "steel"}}],
        "extensions": {{"KHR_materials_variants": {{"variants": [{{"name": "a"}}, {{"name": "b"}}]}}}},
        "extensionsRequired": ["KHR_materials_lint"], "extensionsUsed": ["KHR_materials_lint"]"#
    );
    let file = place.write("a.gltf", maker.text(&rest));
    let with = |ignored: &[&str], variant: Option<&str>| {
        let options = LoadOptions {
            ignored_extensions: ignored.iter().map(|s| (*s).to_owned()).collect(),
            variant: variant.map(str::to_owned),
            ..LoadOptions::default()
        };
        load_with(&file, &options)
    };
    assert!(matches!(with(&[], None), Err(SceneError::RequiredExtension { names, .. }) if names.len() == 1));
    let name = |variant| with(&["KHR_materials_lint"], variant).unwrap().scene.materials[0].name.clone();
    assert_eq!([name(None), name(Some("a")), name(Some("b"))], ["wood", "wood", "steel"]);
    assert!(says(&with(&["KHR_materials_lint"], Some("c")).unwrap(), "there are: a, b"));
    let hash = |variant| with(&["KHR_materials_lint"], variant).unwrap().scene.content_hash;
    assert_ne!(hash(None), hash(Some("b")), "bakes of the one are none of the other");
}

#[test]
fn no_name_leads_out_of_the_folder_or_to_a_device() {
    let place = TempFolder::new("gltf-escapes");
    let secret = place.write("secret.bin", vec![0u8; 48]);
    let inner = place.0.join("inner");
    std::fs::create_dir_all(&inner).unwrap();
    let absolute = secret.display().to_string();
    let mut uris: Vec<String> = [
        "../secret.bin",
        "%2e%2e/secret.bin",
        "..%2Fsecret.bin",
        "..\\\\secret.bin",
        "x/../../secret.bin",
        "%252e%252e/secret.bin",
        "file:///etc/passwd",
        "file:../secret.bin",
        "http://example.org/a.bin",
        "C:\\\\a.bin",
        "\\\\\\\\host\\\\a.bin",
        "nowhere.bin",
        "",
        "data:;base64,*",
        "data:text/plain,abc",
    ]
    .map(String::from)
    .to_vec();
    uris.push(absolute);
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("/dev/zero", inner.join("zero.bin")).unwrap();
        std::os::unix::fs::symlink("../secret.bin", inner.join("link.bin")).unwrap();
        let made = std::process::Command::new("mkfifo").arg(inner.join("pipe.bin")).status();
        assert!(made.is_ok_and(|s| s.success()));
        uris.extend(["zero.bin", "link.bin", "pipe.bin", "."].map(String::from));
    }
    for uri in uris {
        let text = format!(
            r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{"uri": "{uri}", "byteLength": 36}}],
            "bufferViews": [{{"buffer": 0, "byteLength": 36}}],
            "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}}}]}}], "nodes": [{{"mesh": 0}}]}}"#
        );
        let file = inner.join("a.gltf");
        std::fs::write(&file, text).unwrap();
        let error = load(&file).expect_err(&uri);
        let SceneError::Document { pointer, .. } = &error else { panic!("{uri}: {error}") };
        assert_eq!(pointer, "/buffers/0/uri", "{uri}");
        assert!(error.to_string().contains("a.gltf"), "{error}");
    }
}

#[test]
fn numbers_that_leave_the_bytes_end_with_the_place() {
    let place = TempFolder::new("gltf-hostile");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let good = maker.text(&format!(r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{}}]"#));
    assert_eq!(area(&loaded(&place, &good).scene), 1.0);
    let refused = |from: &str, to: &str| -> (PathBuf, String, String) {
        assert!(good.contains(from), "{from}");
        let file = place.write("bad.gltf", good.replacen(from, to, 1));
        match load(&file) {
            Err(SceneError::Document { place, pointer, message }) => (place.path, pointer, message),
            other => panic!("{to}: {other:?}"),
        }
    };
    for (from, to, at) in [
        (r#""count": 4"#, r#""count": 5"#, "/accessors/0"),
        (r#""count": 4"#, r#""count": 1537228672809129302"#, "/accessors/0/count"),
        (r#""count": 4"#, r#""byteOffset": 18446744073709551612, "count": 4"#, "/accessors/0"),
        (r#""byteOffset": 0"#, r#""byteOffset": 18446744073709551600"#, "/bufferViews/0"),
        (r#""byteOffset": 0"#, r#""byteStride": 4, "byteOffset": 0"#, "/accessors/0/bufferView"),
        (r#""byteOffset": 0"#, r#""byteStride": 4294967296, "byteOffset": 0"#, "/bufferViews/0/byteStride"),
        (r#""bufferView": 0"#, r#""bufferView": 99"#, "/bufferViews"),
        (r#""buffer": 0"#, r#""buffer": 7"#, "/buffers"),
        (r#""VEC3""#, r#""VEC2""#, "/accessors/0/type"),
        (r#""VEC3""#, r#""VEC33""#, "/accessors/0/type"),
        (r#""componentType": 5126"#, r#""componentType": 5124"#, "/accessors/0/componentType"),
        (r#""POSITION": 0"#, r#""POSITION": 3"#, "/accessors"),
        (r#""indices": 2"#, r#""indices": 0"#, "/accessors/0"),
        (r#""mesh": 0"#, r#""mesh": 1"#, "/meshes"),
        (r#""mesh": 0"#, r#""mesh": 0, "children": [0]"#, "/nodes/0"),
        (r#""version": "2.0""#, r#""version": "1.0""#, "/asset/version"),
        (r#""material": 0"#, r#""material": 4"#, "/materials"),
        (r#""count": 4"#, r#""count": -1"#, ""),
        (r#""byteLength""#, r#""byteLengths""#, ""),
    ] {
        let (path, pointer, message) = refused(from, to);
        assert!(path.ends_with("bad.gltf") && pointer == at, "{to}: {pointer}: {message}");
        assert!(message.len() > 10, "{message}");
    }
    // Zeros cost nothing to write, so not many of them are made.
    for (count, more) in [
        (1u64 << 31, ""),
        (
            1 << 22,
            r#", "sparse": {"count": 4000000, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}}"#,
        ),
    ] {
        let to = format!(r#""count": {count}, "type": "VEC3"{more}}}, {{"componentType": 5126, "count": 4"#);
        let (_, pointer, _) = refused(
            r#""bufferView": 0, "componentType": 5126, "count": 4"#,
            &format!(r#""componentType": 5126, {to}"#),
        );
        assert!(pointer.starts_with("/accessors/0"), "{pointer}");
    }
    let deep = format!(r#"{{"asset": {}1"#, "[".repeat(100_000));
    assert!(matches!(load(&place.write("deep.gltf", deep)), Err(SceneError::Document { .. })));
    let chunk = maker.glb(&mesh);
    let cut = load(&place.write("cut.glb", &chunk[..chunk.len() - 9]));
    assert!(matches!(cut, Err(SceneError::Container { .. })));
}

#[test]
fn what_a_file_does_not_draw_is_not_read() {
    let place = TempFolder::new("gltf-unused");
    let mut maker = Maker::default();
    let mesh = quad(&mut maker);
    let text = maker.text(&format!(r#"{mesh}, "nodes": [{{"mesh": 0}}], "materials": [{{}}]"#));
    let text = text.replace(
        r#""buffers": ["#,
        r#""unknown": {"deep": [[1]]}, "images": [{"uri": "../x.png"}], "buffers": ["#,
    );
    let text = text.replacen("}],", r#"}, {"uri": "ftp://nowhere", "byteLength": 99}],"#, 1);
    assert_eq!(area(&loaded(&place, text).scene), 1.0);
}

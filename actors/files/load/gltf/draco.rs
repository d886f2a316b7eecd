//! Meshes compressed by Draco (`KHR_draco_mesh_compression`), with the feature `draco`.
//!
//! A compressed primitive stands for the values of its accessors, so those are what is decoded: whatever reads an accessor
//! later finds them. How much there will be is what the accessors declare; a stream that declares more is refused before
//! anything is made of it. What the tables of a stream ask for beyond that the decoder reserves before it reads them, so a
//! file that is made for it can end the program: the feature is for files that one trusts, until the decoder knows better
//! (`gltf_draco` in `fuzz/`).

use std::panic::{AssertUnwindSafe, catch_unwind};

use draco_oxide_core::attribute::{Attribute, ComponentDataType};
use draco_oxide_core::mesh::Mesh;

use super::Problem;
use super::accessor::{Accessors, component_size, components};
use super::document::Primitive;
use super::number::Index;

/// Decodes what a primitive's accessors stand for, once.
pub(super) fn decode(primitive: &Primitive, accessors: &mut Accessors<'_, '_>) -> Result<(), Problem> {
    let Some(packed) = &primitive.extensions.draco else { return Ok(()) };
    let at = format!("/bufferViews/{}", packed.buffer_view.0);
    let wrong =
        |why: String| Problem::new(at.clone(), format!("{why}; export again without Draco compression"));
    let (Some(position), Some(indices)) = (primitive.attributes.position, primitive.indices) else {
        return Err(wrong("is a compressed mesh without positions or indices".to_owned()));
    };
    if accessors.is_decoded(indices) {
        return Ok(());
    }
    let (vertices, corners) = (accessors.count(position)?, accessors.count(indices)?);
    // What is packed comes with 16 numbers of 4 bytes a vertex at most.
    let most = vertices.saturating_mul(64).saturating_add(corners.saturating_mul(4));
    accessors.buffers.expect_decoded(most).map_err(&wrong)?;
    let (bytes, _) = accessors.buffers.view(packed.buffer_view)?;
    check(bytes, vertices, corners / 3).map_err(&wrong)?;
    // The decoder is young: what it did not think of ends here.
    let decoded = catch_unwind(AssertUnwindSafe(|| draco_oxide_decoder::decode_mesh(bytes)));
    let mesh = match decoded {
        Ok(Ok(mesh)) => mesh,
        Ok(Err(why)) => return Err(wrong(format!("is a compressed mesh that cannot be read ({why})"))),
        Err(_) => return Err(wrong("is a compressed mesh that the decoder gave up on".to_owned())),
    };
    let found = catch_unwind(AssertUnwindSafe(|| values(&mesh, primitive, accessors)));
    let found = found.unwrap_or_else(|_| Err("is a compressed mesh that does not hold together".to_owned()));
    for (index, bytes) in found.map_err(wrong)? {
        accessors.buffers.set_values(index, bytes);
    }
    Ok(())
}

/// Whether a stream declares as much as the accessors do, and no more.
fn check(bytes: &[u8], vertices: u64, faces: u64) -> Result<(), String> {
    let mut rest = bytes;
    let mut byte = || {
        let (first, left) = rest.split_first()?;
        rest = left;
        Some(*first)
    };
    let mut head = [0u8; 11];
    for place in &mut head {
        *place = byte().ok_or("is too short for a compressed mesh")?;
    }
    let [b'D', b'R', b'A', b'C', b'O', _, _, _, method, low, high] = head else {
        return Err("is no mesh compressed by Draco".to_owned());
    };
    if u16::from_le_bytes([low, high]) & 0x8000 != 0 {
        return Err("is a compressed mesh with metadata, which is not read".to_owned());
    }
    // Edgebreaker says first how it walks.
    if method == 1 {
        byte();
    }
    let short = "is a compressed mesh cut short";
    let mut number = || varint(&mut byte).ok_or(short);
    let (first, second) = (number()?, number()?);
    let (points, triangles) = if method == 1 { (first, second) } else { (second, first) };
    if points > vertices || triangles != faces {
        return Err(format!(
            "is a compressed mesh of {points} points and {triangles} triangles, but its accessors have {vertices} and {faces}"
        ));
    }
    if method == 1 {
        byte();
        let mut number = || varint(&mut byte).ok_or(short);
        // The decoder reserves what these ask for before it reads any of it.
        let (symbols, split_symbols, splits) = (number()?, number()?, number()?);
        if symbols > faces || split_symbols > faces || splits > faces {
            return Err(format!(
                "is a compressed mesh with more turns and splits than its {faces} triangles"
            ));
        }
    }
    Ok(())
}

/// A number of Draco's: seven bits a byte, the lowest first.
fn varint(byte: &mut impl FnMut() -> Option<u8>) -> Option<u64> {
    let mut value = 0u64;
    for k in 0..5 {
        let next = byte()?;
        value |= u64::from(next & 0x7f) << (7 * k);
        if next & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

/// The bytes of each accessor, as it declares them. The error completes "view …".
fn values(
    mesh: &Mesh,
    primitive: &Primitive,
    accessors: &Accessors<'_, '_>,
) -> Result<Vec<(Index, Vec<u8>)>, String> {
    let (Some(packed), Some(indices)) = (&primitive.extensions.draco, primitive.indices) else {
        return Ok(Vec::new());
    };
    let declared = |index: Index| {
        let of = accessors.document.accessors.get(index.at()).ok_or("names no accessor")?;
        Ok::<_, String>((of.component_type.0, components(&of.shape).unwrap_or(0), of.count.0 as usize))
    };
    let (kind, _, count) = declared(indices)?;
    let width = component_size(kind).unwrap_or(4) as usize;
    let mut bytes = Vec::with_capacity(width * count);
    for corner in mesh.faces.iter().flatten() {
        bytes.extend_from_slice(&(usize::from(*corner) as u32).to_le_bytes()[..width]);
    }
    if bytes.len() != width * count {
        return Err(format!("is a compressed mesh of {} triangles, not {}", mesh.faces.len(), count / 3));
    }
    let mut found = vec![(indices, bytes)];
    for (name, index) in primitive.attributes.named() {
        let Some((_, number)) = packed.attributes.iter().find(|(n, _)| n.as_str() == name) else { continue };
        let of = mesh.attributes.iter().find(|a| a.get_id().as_usize() == number.at());
        let of = of.ok_or_else(|| format!("is a compressed mesh without its attribute {}", number.0))?;
        let (kind, n, count) = declared(index)?;
        let same = component_kind(of.get_component_type()) == Some(kind) && of.get_num_components() == n;
        if !same || of.len() != count {
            return Err(format!("is a compressed mesh whose {name} is not what its accessor declares"));
        }
        found.push((index, flattened(of)));
    }
    Ok(found)
}

/// The values of all points in a row.
fn flattened(of: &Attribute) -> Vec<u8> {
    let size = of.get_component_type().size() * of.get_num_components();
    let unique = of.get_data_as_bytes();
    match of.point_map_as_slice() {
        None => unique.to_vec(),
        Some(map) => map.iter().flat_map(|v| &unique[usize::from(*v) * size..][..size]).copied().collect(),
    }
}

/// glTF's number of a type.
fn component_kind(kind: ComponentDataType) -> Option<u32> {
    Some(match kind {
        ComponentDataType::I8 => 5120,
        ComponentDataType::U8 => 5121,
        ComponentDataType::I16 => 5122,
        ComponentDataType::U16 => 5123,
        ComponentDataType::U32 => 5125,
        ComponentDataType::F32 => 5126,
        _ => return None,
    })
}

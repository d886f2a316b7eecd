//! Skins and morph targets (glTF 2.0 §3.7.3.3, §3.7.2.2), applied as the scene stands.
//!
//! A vertex of a skinned mesh is where its joints put it, each with its weight: the joint's place in the world times what
//! undoes its place when the mesh was bound. The mesh's own node says nothing then.

use glam::{DMat3, DMat4, DVec3, Vec3};

use super::accessor::Accessors;
use super::document::{Document, Primitive, Skin};
use super::meshes::Part;
use super::{Oddities, Problem};

/// Moves a part by its morph targets, each times its weight.
pub(super) fn morph(
    part: &mut Part,
    primitive: &Primitive,
    weights: &[f32],
    accessors: &mut Accessors<'_, '_>,
    odd: &mut Oddities,
) -> Result<(), Problem> {
    let count = part.positions.len() as u64;
    for (target, &weight) in
        primitive.targets.iter().zip(weights).filter(|(_, w)| **w != 0.0 && w.is_finite())
    {
        let lists = [(target.position, &mut part.positions), (target.normal, &mut part.normals)];
        for (index, values) in lists {
            let Some(index) = index else { continue };
            if accessors.is_placeholder(index) || accessors.count(index)? != count {
                odd.count("a morph target of another length than its mesh", "done without");
                continue;
            }
            for (value, delta) in values.iter_mut().zip(accessors.floats::<3>(index, "morph targets")?) {
                *value += Vec3::from(delta) * weight;
            }
        }
    }
    part.normals.iter_mut().for_each(|n| *n = n.normalize_or_zero());
    Ok(())
}

/// World from the space of a mesh at its binding, for each joint; `None` where the skin is not one.
pub(super) fn joints(
    skin: &Skin,
    document: &Document,
    worlds: &[Option<DMat4>],
    accessors: &mut Accessors<'_, '_>,
    odd: &mut Oddities,
) -> Result<Option<Vec<DMat4>>, Problem> {
    let inverse = match skin.inverse_bind_matrices {
        None => vec![DMat4::IDENTITY; skin.joints.len()],
        Some(index) => {
            let good = document
                .accessors
                .get(index.at())
                .is_some_and(|a| a.shape == "MAT4" && a.component_type.0 == 5126);
            let enough = good && accessors.count(index)? >= skin.joints.len() as u64;
            if !enough || accessors.is_placeholder(index) {
                odd.count(
                    "a skin without a matrix for each joint",
                    "not used; its mesh stands as it was bound",
                );
                return Ok(None);
            }
            accessors
                .matrices(index)?
                .into_iter()
                .map(|m| DMat4::from_cols_array(&m.map(f64::from)))
                .collect()
        }
    };
    let place = |joint: usize| worlds.get(joint).copied().flatten();
    let all: Option<Vec<DMat4>> =
        skin.joints.iter().zip(inverse).map(|(j, inverse)| Some(place(j.at())? * inverse)).collect();
    if all.is_none() || skin.joints.is_empty() {
        odd.count("a skin whose joints are not in the scene", "not used; its mesh stands as it was bound");
        return Ok(None);
    }
    Ok(all)
}

/// A part where its joints put it, in the world; `None` where it names no joints that there are.
pub(super) fn skinned(
    part: &Part,
    primitive: &Primitive,
    joints: &[DMat4],
    accessors: &mut Accessors<'_, '_>,
    odd: &mut Oddities,
) -> Result<Option<Part>, Problem> {
    let a = &primitive.attributes;
    let count = part.positions.len();
    let mut bones: Vec<Vec<(usize, f64)>> = vec![Vec::new(); count];
    for (of, by) in [(a.joints0, a.weights0), (a.joints1, a.weights1)] {
        let (Some(of), Some(by)) = (of, by) else { continue };
        let missing = accessors.is_placeholder(of) || accessors.is_placeholder(by);
        if missing || accessors.count(of)? != count as u64 || accessors.count(by)? != count as u64 {
            odd.count("joints or weights of another length than their mesh", "done without");
            continue;
        }
        let of = accessors.floats::<4>(of, "joints")?;
        let by = accessors.floats::<4>(by, "weights")?;
        for ((bones, of), by) in bones.iter_mut().zip(of).zip(by) {
            let some = of.into_iter().zip(by).filter(|(_, w)| *w > 0.0 && w.is_finite());
            bones.extend(some.map(|(j, w)| (j as usize, f64::from(w))));
        }
    }
    let good = bones.iter().all(|b| !b.is_empty() && b.iter().all(|(j, _)| *j < joints.len()));
    if !good {
        odd.count("a skinned mesh with vertices that no joint of its skin moves", "stands as it was bound");
        return Ok(None);
    }
    let mut out = part.clone();
    let mut tangents = out.tangents.iter_mut();
    for ((position, normal), bones) in out.positions.iter_mut().zip(&mut out.normals).zip(&bones) {
        let all: f64 = bones.iter().map(|(_, w)| w).sum();
        let mut sum = DMat4::ZERO;
        for &(j, w) in bones {
            sum += joints[j] * (w / all);
        }
        *position = sum.transform_point3(position.as_dvec3()).as_vec3();
        let linear = DMat3::from_mat4(sum);
        let (x, y, z) = (linear.x_axis, linear.y_axis, linear.z_axis);
        // The inverse transpose, up to a factor.
        let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * linear.determinant().signum();
        *normal = (cofactors * DVec3::from(*normal)).normalize_or_zero().as_vec3();
        if let Some(tangent) = tangents.next() {
            let along = (linear * tangent.truncate().as_dvec3()).normalize_or_zero().as_vec3();
            *tangent = along.extend(tangent.w * linear.determinant().signum() as f32);
        }
    }
    Ok(Some(out))
}

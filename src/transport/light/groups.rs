//! Area lights in groups of neighbours, chosen among by how much they may bring to a surface: the lamp under a cupboard
//! means more to the wall behind it than a window of a hundred times its power (after Conty Estévez & Kulla 2018).

use std::ops::Range;

use glam::Vec3;

use crate::math;

/// Groups at most.
const GROUPS_MAX: usize = 64;
/// Share of the choice that goes by power: what is near may be hidden.
const BY_POWER: f32 = 0.25;

/// An emissive triangle: corners, unit normal of its front, material, power.
pub(super) struct Member {
    pub(super) corners: [Vec3; 3],
    pub(super) normal: Vec3,
    pub(super) material: u32,
    pub(super) power: f64,
}

/// Emissive triangles that follow each other.
#[derive(Clone, Debug, PartialEq)]
struct Group {
    /// Triangles, as places among all emissive ones.
    members: Range<usize>,
    power: f32,
    /// Of a sphere around all of them.
    centre: Vec3,
    radius: f32,
    /// Axis and half angle of a cone around all normals, radians.
    axis: Vec3,
    spread: f32,
}

impl Group {
    fn new(all: &[Member], members: Range<usize>) -> Self {
        let of = &all[members.clone()];
        let corners = || of.iter().flat_map(|m| m.corners);
        let low = corners().fold(Vec3::INFINITY, Vec3::min);
        let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
        let centre = low + 0.5 * (high - low);
        let radius = corners().map(|p| p.distance(centre)).fold(0.0, f32::max);
        let power: f64 = of.iter().map(|m| m.power).sum();
        let axis = of.iter().map(|m| m.normal * (m.power / power) as f32).sum::<Vec3>();
        let axis = axis.try_normalize().unwrap_or(Vec3::Z);
        let spread = of.iter().map(|m| math::acos(axis.dot(m.normal).clamp(-1.0, 1.0))).fold(0.0, f32::max);
        Self { members, power: power as f32, centre, radius, axis, spread }
    }

    /// A bound of what it sends to a surface of this normal, up to a factor that is the same for all groups; 0 only where
    /// it sends nothing.
    fn bound(&self, point: Vec3, normal: Vec3) -> f32 {
        let to = self.centre - point;
        let squared = to.length_squared();
        if !(squared > self.radius * self.radius) {
            return self.power / (self.radius * self.radius).max(f32::MIN_POSITIVE);
        }
        let distance = squared.sqrt();
        let wi = to / distance;
        let extent = math::asin((self.radius / distance).min(1.0));
        let least_angle = |cosine: f32, around: f32| (math::acos(cosine.clamp(-1.0, 1.0)) - around).max(0.0);
        let received = least_angle(wi.dot(normal), extent);
        let sent = least_angle(-wi.dot(self.axis), extent + self.spread);
        // A little more than a right angle: rounding must not lose a grazing light.
        let cosine = |angle: f32| if angle > 1.571 { 0.0 } else { math::cos(angle).max(1e-3) };
        self.power * cosine(received) * cosine(sent) / squared
    }
}

/// All area lights of a scene in groups.
#[derive(Clone, Debug, Default)]
pub(super) struct LightGroups {
    groups: Vec<Group>,
}

impl LightGroups {
    /// Groups follow materials; the most powerful are halved while there are few.
    pub(super) fn new(all: &[Member]) -> Self {
        let total: f64 = all.iter().map(|m| m.power).sum();
        if !(total > 0.0 && total.is_finite()) {
            return Self::default();
        }
        let mut ranges: Vec<Range<usize>> = Vec::new();
        let (mut begin, mut sum) = (0, 0.0);
        for of_material in all.chunk_by(|a, b| a.material == b.material) {
            ranges.push(begin..begin + of_material.len());
            begin += of_material.len();
        }
        if ranges.len() > GROUPS_MAX {
            ranges.clear();
            begin = 0;
            for (i, member) in all.iter().enumerate() {
                sum += member.power;
                let full = sum >= total * (ranges.len() + 1) as f64 / GROUPS_MAX as f64;
                if full && ranges.len() + 1 < GROUPS_MAX || i + 1 == all.len() {
                    ranges.push(begin..i + 1);
                    begin = i + 1;
                }
            }
        }
        let mut groups: Vec<Group> = ranges.into_iter().map(|range| Group::new(all, range)).collect();
        while groups.len() < GROUPS_MAX {
            let divisible = groups.iter().enumerate().filter(|(_, g)| g.members.len() > 1);
            let Some((i, _)) = divisible.max_by(|(_, a), (_, b)| a.power.total_cmp(&b.power)) else { break };
            let Range { start, end } = groups[i].members;
            let middle = start.midpoint(end);
            groups[i] = Group::new(all, start..middle);
            groups.insert(i + 1, Group::new(all, middle..end));
        }
        Self { groups }
    }

    /// Chooses a group for a surface by `u` in [0, 1): its triangles, the probability, and what is left of `u`. `None`
    /// where no light can reach.
    pub(super) fn choose(&self, point: Vec3, normal: Vec3, u: f32) -> Option<(Range<usize>, f32, f32)> {
        if let [group] = &self.groups[..] {
            return (group.bound(point, normal) > 0.0).then(|| (group.members.clone(), 1.0, u));
        }
        let mut bounds = [0.0f32; GROUPS_MAX];
        let (mut total, mut power) = (0.0f32, 0.0f32);
        for (bound, group) in bounds.iter_mut().zip(&self.groups) {
            *bound = group.bound(point, normal);
            if *bound > 0.0 {
                (total, power) = (total + *bound, power + group.power);
            }
        }
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let mut left = u;
        let mut chosen = None;
        for (&bound, group) in bounds.iter().zip(&self.groups).filter(|(bound, _)| **bound > 0.0) {
            let p = (1.0 - BY_POWER) * bound / total + BY_POWER * group.power / power;
            chosen = Some((group.members.clone(), p, (left / p).min(1.0f32.next_down())));
            if left < p {
                break;
            }
            left -= p;
        }
        chosen
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(corner: Vec3, size: f32, material: u32, power: f64) -> Member {
        let corners = [corner, corner + Vec3::X * size, corner + Vec3::Z * size];
        Member { corners, normal: Vec3::NEG_Y, material, power }
    }

    fn share_of(lights: &LightGroups, member: usize, point: Vec3, normal: Vec3) -> f32 {
        let n = 10_000;
        let mut share = 0.0;
        for i in 0..n {
            if let Some((range, p, rest)) = lights.choose(point, normal, i as f32 / n as f32) {
                assert!(p > 0.0 && (0.0..1.0).contains(&rest));
                share += if range.contains(&member) { 1.0 / n as f32 } else { 0.0 };
            }
        }
        share
    }

    #[test]
    fn a_weak_lamp_nearby_is_asked_more_often_than_a_strong_one_far_away() {
        let lights = LightGroups::new(&[
            square(Vec3::new(0.0, 3.0, 0.0), 1.0, 0, 100.0),
            square(Vec3::new(5.0, 0.3, 0.0), 0.1, 1, 1.0),
        ]);
        assert!(share_of(&lights, 1, Vec3::new(5.0, 0.0, 0.0), Vec3::Y) > 0.5);
        assert!(share_of(&lights, 0, Vec3::new(0.5, 1.0, 0.5), Vec3::Y) > 0.95);
        // What may be hidden is never all.
        assert!(share_of(&lights, 0, Vec3::new(5.0, 0.2, 0.0), Vec3::Y) > 0.2);
        // Above both, and facing away, nothing arrives.
        assert!(lights.choose(Vec3::new(0.0, 9.0, 0.0), Vec3::NEG_Y, 0.5).is_none());
        assert!(lights.choose(Vec3::new(0.5, 1.0, 0.5), Vec3::NEG_Y, 0.5).is_none());
    }

    #[test]
    fn every_triangle_is_in_one_group_however_many_there_are() {
        for (count, materials) in [(0, 1), (1, 1), (3, 3), (64, 1), (1000, 2), (1000, 500)] {
            let all: Vec<Member> = (0..count)
                .map(|i| {
                    square(Vec3::X * i as f32, 0.5, (i * materials / count) as u32, 1.0 + (i % 7) as f64)
                })
                .collect();
            let lights = LightGroups::new(&all);
            let mut end = 0;
            for group in &lights.groups {
                assert_eq!(group.members.start, end);
                assert!(!group.members.is_empty() && group.power > 0.0);
                end = group.members.end;
            }
            assert_eq!(end, count);
            assert!(
                lights.groups.len() <= GROUPS_MAX.min(count)
                    && lights.groups.len() >= count.min(GROUPS_MAX / 2)
            );
        }
    }

    #[test]
    fn numbers_that_are_none_choose_nothing() {
        let lights = LightGroups::new(&[square(Vec3::ZERO, 1.0, 0, 1.0), square(Vec3::X, 1.0, 1, 1.0)]);
        assert!(lights.choose(Vec3::NAN, Vec3::Y, 0.5).is_none_or(|c| c.1.is_finite()));
        assert!(lights.choose(Vec3::splat(f32::MAX), Vec3::Y, 0.5).is_none_or(|c| c.1.is_finite()));
        assert!(lights.choose(Vec3::ZERO, Vec3::Y, 0.5).is_some());
        assert!(LightGroups::default().choose(Vec3::ZERO, Vec3::Y, 0.5).is_none());
    }
}

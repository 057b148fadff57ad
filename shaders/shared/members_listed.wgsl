// The instances of the listed groups.
@group(1) @binding(2) var<storage, read> instance_groups: array<InstanceGroup>;
@group(2) @binding(3) var<storage, read> listed: array<u32>;

const NO_MEMBER: u32 = 0xffffffffu;

fn member(index: u32) -> u32 {
    let rank = index / INSTANCE_GROUP;
    if rank >= listed[0] {
        return NO_MEMBER;
    }
    let group = instance_groups[listed[1u + rank]];
    let number = index % INSTANCE_GROUP;
    return select(NO_MEMBER, group.first + number, number < group.count);
}

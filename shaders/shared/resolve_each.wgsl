// Finds the pixels of a tile that show an element of one segment. The file that includes this says in `resolve` what each of them shows.
//!include shared/resolve

// Returns the number of the thread's pixels.
fn resolve_each(group: vec3<u32>, lane: u32) -> u32 {
    let begin = runs[frame.first_run + segment.index].first_slot;
    let count = runs[frame.first_run + segment.index].count;
    var column = column_begin(group, lane);
    var resolved = 0u;
    resolve_load(&column, begin, count);
    loop {
        resolve_seek(&column, begin, count);
        if column_ends(column) {
            break;
        }
        if column.mine {
            resolve(column);
            resolved++;
        }
        resolve_next(&column, begin, count);
    }
    return resolved;
}

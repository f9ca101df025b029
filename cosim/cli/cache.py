"""`flexfmu cache`: where built FMUs and libraries are kept, how much they take, and how they are removed."""

from __future__ import annotations

from flexfmu.cosim.cli.console import print_result


def cache(clear: bool = False, json: bool = False) -> int:
    """Show where built FMUs, compiled libraries and matrices are kept, and what they take.

    The variable FLEXFMU_CACHE names another folder, FLEXFMU_CACHE_LIMIT the most that it takes in MB, 1000 by default: what was used
    longest ago is removed first.

    Args:
        clear: Remove all of it; what is needed again is built again. Default: keep it.
    """
    from flexfmu.fmu_build.cache import cache_folder, cache_limit, cached_files, remove_cached

    found, limit = cached_files(), cache_limit()
    if clear:
        for each in found:
            remove_cached(each)
    size = sum(each.size for each in found)
    data = {"folder": str(cache_folder()), "files": len(found), "bytes": size, "limit": limit, "cleared": clear}
    taken = f"{len(found)} files, {1e-6 * size:.3g} MB"
    text = f"{taken} removed" if clear else f"{taken} of at most {1e-6 * limit:.4g} MB"
    print_result(json, data, f"{data['folder']}: {text}")
    return 0

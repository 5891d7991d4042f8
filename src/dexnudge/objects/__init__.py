"""Objects: built-in shapes, mesh files, and sets of them."""

from dexnudge.objects.builtin import builtin_names, builtin_object
from dexnudge.objects.sets import NamedObject, ObjectEntry, resolve_object, resolve_object_set

__all__ = ["NamedObject", "ObjectEntry", "builtin_names", "builtin_object", "resolve_object", "resolve_object_set"]

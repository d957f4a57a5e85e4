"""Tables with other names, units and kinds of values than the native one, as their owner says they are."""

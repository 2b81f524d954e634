"""Search of the best paths over all paths of a state graph."""

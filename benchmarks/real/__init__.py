"""Real sensors' data, from clones of public repositories: does what holds on gelgap's domains hold there?"""

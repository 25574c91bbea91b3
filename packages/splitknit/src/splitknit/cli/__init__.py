"""The command line: one thin file a verb, which parses arguments, calls the library and prints."""

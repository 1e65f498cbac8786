#!/usr/bin/env perl
# A player for exploit-v0 and equilibrium-v0 in Perl: reads decisions as lines of JSON and answers with strokes.
# It plays the first legal stroke of its list, or else the first legal one.
use strict;
use warnings;

$| = 1;
my @preferred = qw(net-kill smash drop net-shot push short-serve);

while (my $line = <STDIN>) {
    next unless $line =~ /"type": "stroke"/;
    my ($id)    = $line =~ /"id": (\d+)/;
    my ($list)  = $line =~ /"legal": \[([^\]]*)\]/;
    my @legal   = $list =~ /"([^"]+)"/g;
    my $choice  = $legal[0];
    SHOT: for my $shot (@preferred) {
        for my $stroke (@legal) {
            if (index($stroke, "$shot:") == 0) { $choice = $stroke; last SHOT }
        }
    }
    print qq({"id": $id, "stroke": "$choice"}\n);
}
